/* Macros shared by fmi2.c and fmi3.c: entry of a call, and calls that the FMU does not offer.
 *
 * Before including it, a file defines STATUS (its status type), OK and ERROR (two of its values),
 * HANDLE (its pointer to an instance), REFERENCE (its value reference), a struct Instance whose
 * first member is `Fmu fmu`, and `STATUS done(Instance *self, int ok)`, which logs a refusal.
 */
#ifndef FMI_CALLS_H
#define FMI_CALLS_H

/* Refuse the call where the state of the instance is not in the mask; define `self` and `fmu`. */
#define ENTER(LEGAL)                                                                      \
    Instance *self = instance;                                                            \
    if (!self)                                                                            \
        return ERROR;                                                                     \
    Fmu *fmu = &self->fmu;                                                                \
    if (!fmu_allow(fmu, __func__, LEGAL))                                                 \
        return done(self, 0)

static STATUS not_offered(HANDLE instance, const char *call)
{
    Instance *self = instance;
    return self ? done(self, fmu_not_offered(&self->fmu, call)) : ERROR;
}

/* A call that is not offered, with and without arguments after the instance. */
#define CALL(name, ...)                                                                   \
    STATUS name(HANDLE instance, __VA_ARGS__) { return not_offered(instance, #name); }
#define BARE_CALL(name)                                                                   \
    STATUS name(HANDLE instance) { return not_offered(instance, #name); }

/* Access to a type of which the FMU has no variables; asking for none of them is legal. */
#define REFERENCES const REFERENCE r[], size_t n
#define TYPED(name, ...)                                                                  \
    STATUS name(HANDLE instance, REFERENCES, __VA_ARGS__)                                 \
    {                                                                                     \
        return n && instance ? not_offered(instance, #name) : OK;                         \
    }

#endif
