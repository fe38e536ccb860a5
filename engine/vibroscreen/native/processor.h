/* Whether this processor, and the system on it, has all that x86-64-v3 names.

   Asked of the processor itself: __builtin_cpu_supports of a linker's own runtime library may know
   nothing and say no. */
#ifndef PROCESSOR_H
#define PROCESSOR_H

#if defined(__x86_64__)
#include <cpuid.h>

static int has_v3(void) {
    const unsigned basic = bit_FMA | bit_MOVBE | bit_OSXSAVE | bit_AVX | bit_F16C;
    const unsigned extended = bit_BMI | bit_AVX2 | bit_BMI2;
    const unsigned lzcnt = 1u << 5, registers = 6; /* of leaf 0x80000001; saved by the system */
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & basic) != basic) return 0;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if ((low & registers) != registers) return 0;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (b & extended) != extended) return 0;
    return __get_cpuid(0x80000001, &a, &b, &c, &d) && c & lzcnt;
}
#endif

#endif
