# Cross-compiles with ziglang, a clang for many systems in one Python package: cmake -DCMAKE_TOOLCHAIN_FILE=native/zig-toolchain.cmake
# The environment has SVRGS_TARGET, such as aarch64-linux-gnu.2.28, x86_64-windows-gnu, aarch64-macos.11.0, and SVRGS_PYTHON, which has ziglang.
string(REPLACE "-" ";" target "$ENV{SVRGS_TARGET}")
list(GET target 0 CMAKE_SYSTEM_PROCESSOR)
list(GET target 1 system)
if(system MATCHES "^macos")
  set(CMAKE_SYSTEM_NAME Darwin)
  set(CMAKE_OSX_SYSROOT "")
elseif(system STREQUAL "windows")
  set(CMAKE_SYSTEM_NAME Windows)
else()
  set(CMAKE_SYSTEM_NAME Linux)
endif()
set(CMAKE_CXX_COMPILER "$ENV{SVRGS_PYTHON}" -m ziglang c++ -target "$ENV{SVRGS_TARGET}")
