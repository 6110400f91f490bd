/* Reset of a Cortex-M4F in QEMU's mps2-an386: floating point on, then newlib. A fault, as by an
 * instruction in double precision, ends the program with status 1. */

#include <stdint.h>
#include <stdlib.h>

extern void _start(void);

static void reset(void)
{
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20;
    __asm volatile("dsb\n\tisb");
    _start();
}

static void fault(void)
{
    _Exit(1);
}

__attribute__((section(".isr_vector"), used)) static void (*const vectors[])(void) = {
    (void (*)(void))0x00400000u, reset, fault, fault, fault, fault, fault,
};
