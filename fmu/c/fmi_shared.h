/* Functions that FMI 2.0 and FMI 3.0 share but for their names; included at the end of fmi2.c and fmi3.c.
 *
 * Before including it, a file defines besides the macros of fmi_calls.h: FMI(name), which adds the
 * prefix of the version; FMU_STATE, BYTE and TRUTH, its types of a saved state, a byte and a Boolean;
 * the names that the versions spell differently (FMI_GET_STATE …); FMI_LEGAL_TO_GET_NOMINALS.
 */
STATUS FMI(ExitInitializationMode)(HANDLE instance)
{
    ENTER(LEGAL_TO_EXIT);
    return done(self, fmu_exit_initialization(fmu));
}

STATUS FMI(Terminate)(HANDLE instance)
{
    ENTER(LEGAL_TO_TERMINATE);
    return done(self, fmu_terminate(fmu));
}

STATUS FMI(Reset)(HANDLE instance)
{
    ENTER(ANY_STATE);
    fmu_reset(fmu);
    return OK;
}

/* ---- Saved states -------------------------------------------------------------------------- */

STATUS FMI_GET_STATE(HANDLE instance, FMU_STATE *saved)
{
    ENTER(ANY_STATE);
    return done(self, fmu_save(fmu, (Saved **)saved));
}

STATUS FMI_SET_STATE(HANDLE instance, FMU_STATE saved)
{
    ENTER(ANY_STATE);
    return done(self, fmu_restore(fmu, saved));
}

STATUS FMI_FREE_STATE(HANDLE instance, FMU_STATE *saved)
{
    if (!instance)
        return ERROR;
    fmu_free_saved(saved);
    return OK;
}

STATUS FMI_STATE_SIZE(HANDLE instance, FMU_STATE saved, size_t *size)
{
    if (!instance)
        return ERROR;
    *size = sizeof(Saved);
    return OK;
}

STATUS FMI_SERIALIZE(HANDLE instance, FMU_STATE saved, BYTE bytes[], size_t size)
{
    ENTER(ANY_STATE);
    return done(self, fmu_serialize(fmu, saved, bytes, size));
}

STATUS FMI_DESERIALIZE(HANDLE instance, const BYTE bytes[], size_t size, FMU_STATE *saved)
{
    ENTER(ANY_STATE);
    return done(self, fmu_deserialize(fmu, bytes, size, (Saved **)saved));
}

/* ---- Model Exchange ------------------------------------------------------------------------ */

STATUS FMI(EnterContinuousTimeMode)(HANDLE instance)
{
    ENTER(LEGAL_TO_UPDATE);
    return done(self, fmu_enter_continuous_time(fmu));
}

STATUS FMI(CompletedIntegratorStep)(HANDLE instance, TRUTH noSetFMUStatePrior,
                                    TRUTH *enterEventMode, TRUTH *terminateSimulation)
{
    ENTER(LEGAL_TO_INTEGRATE);
    *enterEventMode = *terminateSimulation = 0;
    return done(self, fmu_complete_step(fmu));
}

STATUS FMI(SetTime)(HANDLE instance, double time)
{
    ENTER(LEGAL_TO_SET_TIME);
    return done(self, fmu_set_time(fmu, time));
}

STATUS FMI(SetContinuousStates)(HANDLE instance, const double x[], size_t n)
{
    ENTER(LEGAL_TO_INTEGRATE);
    return done(self, fmu_set_states(fmu, x, n));
}

STATUS FMI(GetContinuousStates)(HANDLE instance, double x[], size_t n)
{
    ENTER(LEGAL_TO_EVALUATE);
    return done(self, fmu_get_states(fmu, x, n));
}

STATUS FMI_GET_RATES(HANDLE instance, double rates[], size_t n)
{
    ENTER(LEGAL_TO_EVALUATE);
    return done(self, fmu_get_rates(fmu, rates, n));
}

STATUS FMI(GetEventIndicators)(HANDLE instance, double indicators[], size_t n)
{
    ENTER(LEGAL_TO_EVALUATE);
    return done(self, fmu_get_indicators(fmu, indicators, n));
}

STATUS FMI(GetNominalsOfContinuousStates)(HANDLE instance, double nominals[], size_t n)
{
    ENTER(FMI_LEGAL_TO_GET_NOMINALS);
    return done(self, fmu_get_nominals(fmu, nominals, n));
}
