// Ruckig's wheel is compiled by a newer compiler than ours may be: its code names a function of the newer standard
// library, which it never calls. Programs that link to this library would have to find it.

extern "C" __attribute__((visibility("hidden"))) void _ZSt21ios_base_library_initv() {}
