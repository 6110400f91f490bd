/* Prints the bytes of the memory of the law, and the instructions of one period: with -icount
 * shift=0 QEMU takes 1 ns for each, and the timer of the board counts at 25 MHz. SETTLES: the law
 * has a settle. */

#include <stdint.h>
#include <stdio.h>

#include "control.h"
#include "recorded.h"

#define TIMER ((volatile uint32_t *)0xE000E010u)

int main(void)
{
    const control_gains *gains = &control_exported_gains;
    control_memory memory;
    control_real demand[CONTROL_AXES];

    control_init(gains, &memory, &recorded[0].setpoint, &recorded[0].measurement);
    TIMER[1] = 0xFFFFFFu;
    TIMER[2] = 0;
    TIMER[0] = 5;
    const uint32_t begin = TIMER[2];
    for (int k = 0; k < TICKS; k++) {
        control_step(gains, &memory, &recorded[k].setpoint, &recorded[k].measurement, demand);
#ifdef SETTLES
        control_settle(gains, &memory, demand, demand);
#endif
    }
    const uint32_t end = TIMER[2];
    printf("%u %u\n", (unsigned)sizeof memory,
           (unsigned)(((begin - end) & 0xFFFFFFu) * 40u / TICKS));
    return 0;
}
