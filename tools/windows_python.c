// Starts the Python of python311.dll, which has no program of its own in panda3d's wheel (tools/test_windows.sh).
#include <windows.h>

typedef int (*python_main)(int, wchar_t**);

int wmain(int argc, wchar_t** argv) {
  HMODULE python = LoadLibraryW(L"python311.dll");
  python_main run = python ? (python_main)(void*)GetProcAddress(python, "Py_Main") : NULL;
  return run ? run(argc, argv) : 127;
}
