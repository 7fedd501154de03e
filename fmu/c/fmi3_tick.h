/* A tick of the robot's loop in one call, beyond the standard; a part of fmi3.c. */
#ifndef FMI3_TICK_H
#define FMI3_TICK_H

/* Set inputs, step where the step is positive, get values (a Boolean as 1 or 0). The first step ends
 * the initialization mode; a step of zero evaluates the outputs only. */
FMI3_Export fmi3Status dropstitch_tick(fmi3Instance instance, const fmi3ValueReference inputs[],
                                       size_t nInputs, const double values[], double step_s,
                                       const fmi3ValueReference outputs[], size_t nOutputs,
                                       double results[])
{
    ENTER(INITIALIZING | STEPPING);
    int ok = fmu_set_float64(fmu, inputs, nInputs, values);
    if (ok && step_s > 0.0 && fmu->memory.mode == INITIALIZING)
        ok = fmu_exit_initialization(fmu);
    if (ok && step_s > 0.0)
        ok = fmu_step(fmu, fmu->memory.value[0], step_s);
    else if (ok)
        ok = fmu_refresh(fmu);
    for (size_t i = 0; ok == 1 && i < nOutputs; i++)
        results[i] = fmu->memory.value[outputs[i]];
    return done(self, ok);
}

#endif
