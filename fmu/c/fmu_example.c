/* Example motion: until the host sets one of its inputs, the FMU sets these inputs itself, so that
 * a tool that simulates the FMU without inputs shows a motion. It begins at the start values, and
 * does not affect a host that sets its inputs before the first step.
 */
#include "fmu_core.h"
#include "fmu_math.h"

enum { EXAMPLE_SCALE = FIRST_OUTPUT - 1 }; /* its parameter is the last one */

static void set_inputs(Fmu *fmu, double swing)
{
    for (size_t i = 0; i < N_INPUTS; i++)
        if (EXAMPLE[i] != 0.0)
            fmu->memory.value[FIRST_INPUT + i] = VARIABLES[FIRST_INPUT + i].start + swing * EXAMPLE[i];
}

/* Set the inputs of the example to their values at this time. */
void fmu_follow_example(Fmu *fmu, double time_s)
{
    Memory *memory = &fmu->memory;
    if (memory->driven)
        return;
    double turns = (time_s - memory->start_s) / EXAMPLE_PERIOD_S;
    set_inputs(fmu, memory->value[EXAMPLE_SCALE] * sin(6.283185307179586 * (turns - floor(turns))));
    memory->stale = STALE;
}

/* End the example as soon as the host sets one of its inputs; the others return to their start. */
void fmu_end_example(Fmu *fmu, const uint32_t reference[], size_t count)
{
    int moving = 0;
    if (fmu->memory.driven)
        return;
    for (size_t i = 0; i < count; i++)
        moving |= reference[i] < FIRST_PARAMETER && reference[i] >= FIRST_INPUT &&
                  EXAMPLE[reference[i] - FIRST_INPUT] != 0.0;
    if (!moving)
        return;
    set_inputs(fmu, 0.0);
    fmu->memory.driven = 1;
}
