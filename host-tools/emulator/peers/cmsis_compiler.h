/* Instructions that CMSIS-DSP takes from the CMSIS core, which no package carries, in the compiler's own names. */

#ifndef CMSIS_COMPILER_H
#define CMSIS_COMPILER_H

#include <arm_acle.h>
#include <stdint.h>

#define __ASM __asm__
#define __ALIGNED(x) __attribute__((aligned(x)))
#define __STATIC_INLINE static inline
#define __STATIC_FORCEINLINE static inline __attribute__((always_inline))
#define __WEAK __attribute__((weak))

#define __CLZ __clz
#define __PKHBT(low, high, shift) (((uint32_t)(low) & 0xffff) | ((uint32_t)(high) << (shift) & 0xffff0000))
#define __QADD __qadd
#define __QADD16 __qadd16
#define __QSUB __qsub
#define __QSUB16 __qsub16
#define __ROR __ror
#define __SMLAD __smlad
#define __SMLALD __smlald
#define __SMUAD __smuad
#define __SSAT __ssat
#define __USAT __usat

#endif
