// The end of the pool's threads when a program unloads the library. Where the compiler brings its own start files, they ask the C library for
// the destructors of static objects; those of zig do not. To ask twice does no harm.
#if defined(__ELF__)
extern "C" {
void __cxa_finalize(void*);
extern void* __dso_handle;
}

namespace {
[[gnu::destructor]] void unload() { __cxa_finalize(&__dso_handle); }
}  // namespace
#endif
