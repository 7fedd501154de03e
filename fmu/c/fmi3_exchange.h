/* Functions of FMI 3.0 for Model Exchange; included at the end of fmi3.c. */
fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    ENTER(LEGAL_TO_INTEGRATE);
    return done(self, fmu_enter_event_mode(fmu));
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)
{
    ENTER(LEGAL_TO_UPDATE);
    Update update;
    int ok = fmu_update(fmu, &update);
    if (ok) {
        *discreteStatesNeedUpdate = *terminateSimulation = fmi3False;
        *nominalsOfContinuousStatesChanged = fmi3False;
        *valuesOfContinuousStatesChanged = update.states_changed;
        *nextEventTimeDefined = fmi3True;
        *nextEventTime = update.next_s;
    }
    return done(self, ok);
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    ENTER(LEGAL_TO_UPDATE);
    return done(self, fmu_enter_continuous_time(fmu));
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance,
                                       fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode,
                                       fmi3Boolean *terminateSimulation)
{
    ENTER(LEGAL_TO_INTEGRATE);
    *enterEventMode = *terminateSimulation = fmi3False;
    return done(self, fmu_complete_step(fmu));
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    ENTER(LEGAL_TO_SET_TIME);
    return done(self, fmu_set_time(fmu, time));
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates)
{
    ENTER(LEGAL_TO_INTEGRATE);
    return done(self, fmu_set_states(fmu, continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[],
                                   size_t nContinuousStates)
{
    ENTER(LEGAL_TO_EVALUATE);
    return done(self, fmu_get_states(fmu, continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t nContinuousStates)
{
    ENTER(LEGAL_TO_EVALUATE);
    return done(self, fmu_get_rates(fmu, derivatives, nContinuousStates));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[],
                                  size_t nEventIndicators)
{
    ENTER(LEGAL_TO_EVALUATE);
    return done(self, fmu_get_indicators(fmu, eventIndicators, nEventIndicators));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[],
                                             size_t nContinuousStates)
{
    ENTER(LEGAL_TO_EVALUATE);
    return done(self, fmu_get_nominals(fmu, nominals, nContinuousStates));
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators)
{
    ENTER(ANY_STATE);
    *nEventIndicators = N_INDICATORS;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates)
{
    ENTER(ANY_STATE);
    *nContinuousStates = N_CONTINUOUS;
    return fmi3OK;
}
