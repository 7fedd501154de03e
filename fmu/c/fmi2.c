/* FMI 2.0 for Model Exchange and Co-Simulation: signatures and types of the standard on top of fmu_core.c.
 *
 * Functions that this FMU does not offer are exported too, because importers look up every
 * function: see the end.
 */
#include "fmi2Functions.h"

#include <stdlib.h>
#include <string.h>

#include "fmu_core.h"

typedef struct {
    Fmu fmu; /* first, so that a pointer to one is a pointer to the other */
    fmi2CallbackFunctions callbacks;
    char name[64];
} Instance;

/* Errors are logged whether debug logging is on or not. */
static fmi2Status done(Instance *self, int ok)
{
    if (ok == 1)
        return fmi2OK;
    fmi2Status status = ok == DISCARDED ? fmi2Discard : fmi2Error;
    if (self->callbacks.logger)
        self->callbacks.logger(self->callbacks.componentEnvironment, self->name, status,
                               "logStatusError", "%s", self->fmu.message);
    return status;
}

#define STATUS fmi2Status
#define OK fmi2OK
#define ERROR fmi2Error
#define HANDLE fmi2Component
#define REFERENCE fmi2ValueReference
#include "fmi_calls.h"

/* ---- Creation and destruction -------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component instance, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    ENTER(ANY_STATE);
    return done(self, fmu_check_log_categories(fmu, categories, nCategories));
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean loggingOn)
{
    Instance *self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    if (functions)
        self->callbacks = *functions;
    if (instanceName)
        strncpy(self->name, instanceName, sizeof self->name - 1);
    self->fmu.exchange = fmuType == fmi2ModelExchange;
    fmu_reset(&self->fmu);
    int ok = fmuType == fmi2CoSimulation || fmuType == fmi2ModelExchange
                 ? fmu_check_token(&self->fmu, fmuGUID, "GUID")
                 : fmu_refuse(&self->fmu, "There is no such type of FMU.");
    if (ok)
        return self;
    done(self, 0);
    free(self);
    return NULL;
}

void fmi2FreeInstance(fmi2Component instance) { free(instance); }

/* ---- Initialization, steps, end ------------------------------------------------------------ */

fmi2Status fmi2SetupExperiment(fmi2Component instance, fmi2Boolean toleranceDefined,
                               fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    ENTER(LEGAL_TO_ENTER);
    return done(self, fmu_start_at(fmu, startTime, stopTimeDefined, stopTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component instance)
{
    ENTER(LEGAL_TO_ENTER);
    return done(self, fmu_enter_initialization(fmu));
}

fmi2Status fmi2DoStep(fmi2Component instance, fmi2Real currentCommunicationPoint,
                      fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    ENTER(LEGAL_TO_STEP);
    return done(self, fmu_step(fmu, currentCommunicationPoint, communicationStepSize));
}

fmi2Status fmi2GetRealStatus(fmi2Component instance, const fmi2StatusKind s, fmi2Real *value)
{
    ENTER(STEPPING | TERMINATED);
    if (s != fmi2LastSuccessfulTime)
        return done(self, fmu_refuse(fmu, "The only real status is the last successful time."));
    *value = fmu->memory.value[0];
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component instance, const fmi2StatusKind s, fmi2Boolean *value)
{
    ENTER(STEPPING | TERMINATED);
    if (s != fmi2Terminated)
        return done(self, fmu_refuse(fmu, "The only Boolean status is 'terminated'."));
    *value = fmu->memory.mode == TERMINATED;
    return fmi2OK;
}

/* ---- Variables ----------------------------------------------------------------------------- */

fmi2Status fmi2GetReal(fmi2Component instance, const fmi2ValueReference vr[], size_t nvr,
                       fmi2Real value[])
{
    ENTER(LEGAL_TO_GET);
    return done(self, fmu_get_float64(fmu, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component instance, const fmi2ValueReference vr[], size_t nvr,
                       const fmi2Real value[])
{
    ENTER(LEGAL_TO_SET);
    return done(self, fmu_set_float64(fmu, vr, nvr, value));
}

fmi2Status fmi2GetBoolean(fmi2Component instance, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Boolean value[])
{
    ENTER(LEGAL_TO_GET);
    int truth, ok = fmu_check_booleans(fmu, vr, nvr);
    for (size_t i = 0; ok && i < nvr; i++)
        if ((ok = fmu_get_boolean(fmu, vr[i], &truth)))
            value[i] = truth;
    return done(self, ok);
}

/* ---- Derivatives --------------------------------------------------------------------------- */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component instance, const fmi2ValueReference unknown[],
                                        size_t nUnknown, const fmi2ValueReference known[],
                                        size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    ENTER(LEGAL_TO_GET);
    return done(self, fmu_forward(fmu, unknown, nUnknown, known, nKnown, dvKnown, dvUnknown));
}

/* ---- Model Exchange ------------------------------------------------------------------------ */

fmi2Status fmi2EnterEventMode(fmi2Component instance)
{
    ENTER(LEGAL_TO_SET_TIME);
    return done(self, fmu_enter_event_mode(fmu));
}

fmi2Status fmi2NewDiscreteStates(fmi2Component instance, fmi2EventInfo *info)
{
    ENTER(LEGAL_TO_UPDATE);
    Update update;
    int ok = fmu_update(fmu, &update);
    if (ok) {
        info->newDiscreteStatesNeeded = info->terminateSimulation = fmi2False;
        info->nominalsOfContinuousStatesChanged = fmi2False;
        info->valuesOfContinuousStatesChanged = update.states_changed;
        info->nextEventTimeDefined = fmi2True;
        info->nextEventTime = update.next_s;
    }
    return done(self, ok);
}

/* ---- As in FMI 3.0 ------------------------------------------------------------------------- */

#define FMI(name) fmi2##name
#define FMU_STATE fmi2FMUstate
#define BYTE fmi2Byte
#define TRUTH fmi2Boolean
#define FMI_GET_STATE fmi2GetFMUstate
#define FMI_SET_STATE fmi2SetFMUstate
#define FMI_FREE_STATE fmi2FreeFMUstate
#define FMI_STATE_SIZE fmi2SerializedFMUstateSize
#define FMI_SERIALIZE fmi2SerializeFMUstate
#define FMI_DESERIALIZE fmi2DeSerializeFMUstate
#define FMI_GET_RATES fmi2GetDerivatives
#define FMI_LEGAL_TO_GET_NOMINALS (LEGAL_TO_EVALUATE | INSTANTIATED)
#include "fmi_shared.h"

/* ---- Not offered --------------------------------------------------------------------------- */

TYPED(fmi2GetInteger, fmi2Integer value[])
TYPED(fmi2SetInteger, const fmi2Integer value[])
TYPED(fmi2GetString, fmi2String value[])
TYPED(fmi2SetString, const fmi2String value[])
TYPED(fmi2SetBoolean, const fmi2Boolean value[])

CALL(fmi2SetRealInputDerivatives, REFERENCES, const fmi2Integer order[], const fmi2Real value[])
CALL(fmi2GetRealOutputDerivatives, REFERENCES, const fmi2Integer order[], fmi2Real value[])
BARE_CALL(fmi2CancelStep)
CALL(fmi2GetStatus, const fmi2StatusKind s, fmi2Status *value)
CALL(fmi2GetIntegerStatus, const fmi2StatusKind s, fmi2Integer *value)
CALL(fmi2GetStringStatus, const fmi2StatusKind s, fmi2String *value)
