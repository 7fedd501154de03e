/* Fuzzer of call sequences: random legal and illegal calls of one version of FMI with random values.
 *
 * The FMU is linked into the program, under sanitizers. A value that is not a finite number must not
 * come with OK, and a refused call must not end the instance. Arguments: seed, seconds, calls.
 * Prints the number of calls and of those that returned OK.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmu_core.h"

#if FMI == 2
#include "fmi2Functions.h"
typedef fmi2Component Handle;
#define F(name) fmi2##name
typedef fmi2FMUstate State;
#else
#include "fmi3Functions.h"
typedef fmi3Instance Handle;
#define F(name) fmi3##name
typedef fmi3FMUState State;
#endif

enum { MOST = 8, OK = 0, DISCARD = 2, ERROR = 3, INSTANCES = 3 };
enum { BYTES = sizeof(Saved) + 16 };

typedef struct {
    Handle handle;
    State state;
    double time_s;
} Slot;

static uint64_t seed_state;
static unsigned long long calls, accepted;

/* xorshift64 (Marsaglia 2003). */
static uint64_t draw(void)
{
    seed_state ^= seed_state << 13;
    seed_state ^= seed_state >> 7;
    return seed_state ^= seed_state << 17;
}

static unsigned below(unsigned n) { return (unsigned)(draw() % n); }

static double unit(void) { return (double)(draw() >> 11) / 9007199254740992.0; }

/* Mostly usable values, sometimes any bits of a double. */
static double number(void)
{
    static const double ODD[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 5e-324, 0.0, -0.0};
    union { uint64_t bits; double value; } any;
    switch (below(16)) {
    case 0: return ODD[below(sizeof ODD / sizeof *ODD)];
    case 1: any.bits = draw(); return any.value;
    case 2: return 1e3 * (unit() - 0.5);
    default: return 2.0 * unit() - 1.0;
    }
}

static uint32_t reference(void)
{
    return below(32) ? below(N_VARIABLES) : (uint32_t)draw();
}

static int judge(int status, const double *value, size_t count, const char *call)
{
    calls++;
    if (status == OK) {
        accepted++;
        for (size_t i = 0; value && i < count; i++)
            if (!isfinite(value[i])) {
                fprintf(stderr, "%s returned OK with a value that is not finite\n", call);
                abort();
            }
    } else if (status != DISCARD && status != ERROR) {
        fprintf(stderr, "%s returned the status %d\n", call, status);
        abort();
    }
    return status == OK;
}

static size_t references(uint32_t r[MOST])
{
    size_t count = below(MOST);
    for (size_t i = 0; i < count; i++)
        r[i] = reference();
    return count;
}

static void numbers(double v[MOST])
{
    for (size_t i = 0; i < MOST; i++)
        v[i] = number();
}

#if FMI == 2
static void silent(fmi2ComponentEnvironment e, fmi2String i, fmi2Status s, fmi2String c,
                   fmi2String m, ...) { (void)e; (void)i; (void)s; (void)c; (void)m; }
static const fmi2CallbackFunctions CALLBACKS = {silent, calloc, free, NULL, NULL};
#else
static void silent(fmi3InstanceEnvironment e, fmi3Status s, fmi3String c, fmi3String m)
{
    (void)e; (void)s; (void)c;
    if (strlen(m) > 255)
        abort();
}
#endif

static void instantiate(Slot *slot)
{
    static const char *const PATHS[] = {NULL, "", "file:///", "file:///../../etc/passwd", "%n%s%x",
                                        "/nowhere/\xff\xfe", "http://example.org/a b"};
    const char *path = PATHS[below(sizeof PATHS / sizeof *PATHS)];
    const char *token = below(8) ? FMU_TOKEN : below(2) ? NULL : "%s%n";
    static char name[4096];
    memset(name, 'x', sizeof name - 1);
    int exchange = below(2);
#if FMI == 2
    slot->handle = fmi2Instantiate(below(4) ? name : NULL, below(16) ? exchange ? fmi2ModelExchange
                                   : fmi2CoSimulation : 7, token, path,
                                   below(8) ? &CALLBACKS : NULL, 0, below(2));
#else
    slot->handle = exchange
        ? fmi3InstantiateModelExchange(name, token, path, 0, below(2), NULL, below(8) ? silent : NULL)
        : fmi3InstantiateCoSimulation(name, token, path, 0, below(2), below(16) == 0, below(2), NULL,
                                      0, NULL, below(8) ? silent : NULL, NULL);
#endif
    slot->time_s = 0.0;
    slot->state = NULL;
    calls++;
}

static void release(Slot *slot)
{
    if (slot->handle && slot->state)
#if FMI == 2
        fmi2FreeFMUstate(slot->handle, &slot->state);
#else
        fmi3FreeFMUState(slot->handle, &slot->state);
#endif
    F(FreeInstance)(slot->handle);
    slot->handle = NULL;
    slot->state = NULL;
    calls += 2;
}

static void initialize(Slot *slot)
{
    double start_s = below(4) ? 0.0 : number(), stop_s = below(4) ? 1e3 : number();
#if FMI == 2
    judge(fmi2SetupExperiment(slot->handle, 0, 0.0, start_s, below(2), stop_s), NULL, 0, "setup");
    int ok = judge(fmi2EnterInitializationMode(slot->handle), NULL, 0, "enter");
#else
    int ok = judge(fmi3EnterInitializationMode(slot->handle, 0, 0.0, start_s, below(2), stop_s), NULL,
                   0, "enter");
#endif
    if (ok)
        slot->time_s = start_s;
}

static void step(Slot *slot)
{
    double step_s = below(8) ? 0.05 * unit() : number(), time_s = below(16) ? slot->time_s : number();
    double last_s = time_s + step_s;
    int status;
#if FMI == 2
    status = fmi2DoStep(slot->handle, time_s, step_s, 1);
#else
    fmi3Boolean event, end, early;
    status = fmi3DoStep(slot->handle, time_s, step_s, 1, &event, &end, &early, &last_s);
#endif
    if (judge(status, &last_s, 1, "step"))
        slot->time_s = last_s;
}

static void values(Slot *slot)
{
    uint32_t r[MOST];
    double v[MOST];
    size_t n = references(r), m = below(32) || FMI == 2 ? n : below(MOST);
    numbers(v);
#if FMI == 2
    fmi2Boolean truth[MOST];
    judge(fmi2SetReal(slot->handle, r, n, v), NULL, 0, "set");
    n = references(r);
    judge(fmi2GetReal(slot->handle, r, n, v), v, n, "get");
    judge(fmi2GetBoolean(slot->handle, r, n, truth), NULL, 0, "getBoolean");
    (void)m;
#else
    fmi3Boolean truth[MOST];
    judge(fmi3SetFloat64(slot->handle, r, n, v, m), NULL, 0, "set");
    n = references(r);
    judge(fmi3GetFloat64(slot->handle, r, n, v, n), v, n, "get");
    judge(fmi3GetBoolean(slot->handle, r, n, truth, n), NULL, 0, "getBoolean");
#endif
}

static void derivatives(Slot *slot)
{
    uint32_t unknown[MOST], known[MOST];
    double seed[MOST], slope[MOST];
    size_t unknowns = references(unknown), knowns = references(known);
    for (size_t i = 0; below(4) && i < unknowns; i++)
        unknown[i] = FIRST_OUTPUT + below(N_VARIABLES - FIRST_OUTPUT);
    for (size_t i = 0; i < knowns; i++)
        known[i] = below(4) ? below(FIRST_OUTPUT) : known[i];
    numbers(seed);
#if FMI == 2
    judge(fmi2GetDirectionalDerivative(slot->handle, unknown, unknowns, known, knowns, seed, slope),
          slope, unknowns, "directional");
#else
    judge(fmi3GetDirectionalDerivative(slot->handle, unknown, unknowns, known, knowns, seed, knowns,
                                       slope, unknowns), slope, unknowns, "directional");
    judge(fmi3GetAdjointDerivative(slot->handle, unknown, unknowns, known, knowns, seed, unknowns,
                                   slope, knowns), slope, knowns, "adjoint");
#endif
}

static void events(Slot *slot)
{
    double next_s = 0.0;
    int status;
#if FMI == 2
    fmi2EventInfo info;
    status = fmi2NewDiscreteStates(slot->handle, &info);
    if (status == OK)
        next_s = info.nextEventTime;
#else
    fmi3Boolean more, end, nominals, changed, defined;
    status = fmi3UpdateDiscreteStates(slot->handle, &more, &end, &nominals, &changed, &defined,
                                      &next_s);
#endif
    judge(status, &next_s, 1, "update");
    if (below(8))
        judge(F(EnterContinuousTimeMode)(slot->handle), NULL, 0, "continuous");
    if (judge(F(SetTime)(slot->handle, below(8) ? next_s : number()), NULL, 0, "time") && below(2))
        judge(F(EnterEventMode)(slot->handle), NULL, 0, "event");
}

static void integration(Slot *slot)
{
    double v[N_KNOWNS + N_INDICATORS + 2];
    size_t n = below(16) ? N_CONTINUOUS : below(N_CONTINUOUS + 2);
    for (size_t i = 0; i < n; i++)
        v[i] = number();
    judge(F(SetContinuousStates)(slot->handle, v, n), NULL, 0, "setStates");
#if FMI == 2
    judge(fmi2GetDerivatives(slot->handle, v, n), v, n, "rates");
    fmi2Boolean event, end;
#else
    judge(fmi3GetContinuousStateDerivatives(slot->handle, v, n), v, n, "rates");
    fmi3Boolean event, end;
#endif
    judge(F(GetContinuousStates)(slot->handle, v, n), v, n, "states");
    judge(F(GetNominalsOfContinuousStates)(slot->handle, v, n), v, n, "nominals");
    judge(F(GetEventIndicators)(slot->handle, v, N_INDICATORS), v, N_INDICATORS, "indicators");
    judge(F(CompletedIntegratorStep)(slot->handle, 1, &event, &end), NULL, 0, "completed");
}

#if FMI == 2
#define GET_STATE fmi2GetFMUstate
#define SET_STATE fmi2SetFMUstate
#define SIZE_OF_STATE fmi2SerializedFMUstateSize
#define SERIALIZE fmi2SerializeFMUstate
#define DESERIALIZE fmi2DeSerializeFMUstate
#else
#define GET_STATE fmi3GetFMUState
#define SET_STATE fmi3SetFMUState
#define SIZE_OF_STATE fmi3SerializedFMUStateSize
#define SERIALIZE fmi3SerializeFMUState
#define DESERIALIZE fmi3DeserializeFMUState
#endif

/* Save, restore in any instance, and read bytes that are whole, short, long or flipped. */
static void states(Slot *slot, Slot *other)
{
    unsigned char bytes[BYTES];
    size_t size = 0;
    judge(GET_STATE(slot->handle, &slot->state), NULL, 0, "save");
    if (!slot->state || !judge(SIZE_OF_STATE(slot->handle, slot->state, &size), NULL, 0, "size"))
        return;
    memset(bytes, 0, sizeof bytes);
    if (!judge(SERIALIZE(slot->handle, slot->state, (void *)bytes, size), NULL, 0, "serialize"))
        return;
    if (below(2))
        bytes[below((unsigned)size)] ^= (unsigned char)(1u << below(8));
    if (!below(4))
        size = below(BYTES);
    judge(DESERIALIZE(other->handle, (void *)bytes, size, &other->state), NULL, 0, "deserialize");
    if (other->state && judge(SET_STATE(other->handle, other->state), NULL, 0, "restore"))
        other->time_s = below(2) ? slot->time_s : 0.0;
}

static void call(Slot *slot, Slot *other)
{
    switch (below(20)) {
    case 0: initialize(slot); break;
    case 1: judge(F(ExitInitializationMode)(slot->handle), NULL, 0, "exit"); break;
    case 2: if (!below(8)) judge(F(Terminate)(slot->handle), NULL, 0, "terminate"); break;
    case 3:
        if (!below(8) && judge(F(Reset)(slot->handle), NULL, 0, "reset"))
            slot->time_s = 0.0;
        break;
    case 4: if (!below(16)) release(slot); break;
    case 5: if (other->handle) states(slot, other); break;
    case 6: case 7: derivatives(slot); break;
    case 8: case 9: events(slot); break;
    case 10: case 11: integration(slot); break;
    case 12: case 13: case 14: values(slot); break;
    default: step(slot); break;
    }
}

int main(int count, char **argument)
{
    double seconds = count > 2 ? atof(argument[2]) : 1.0;
    unsigned long long most = count > 3 ? strtoull(argument[3], NULL, 10) : ~0ULL;
    Slot slots[INSTANCES] = {{NULL, NULL, 0.0}};
    time_t begin = time(NULL);
    seed_state = (count > 1 ? strtoull(argument[1], NULL, 10) : 1) * 2654435769u + 88172645463325252u;
    while (calls < most && difftime(time(NULL), begin) <= seconds) {
        Slot *slot = &slots[below(INSTANCES)];
        if (!slot->handle)
            instantiate(slot);
        else
            call(slot, &slots[below(INSTANCES)]);
    }
    for (int i = 0; i < INSTANCES; i++)
        if (slots[i].handle)
            release(&slots[i]);
    printf("%llu %llu\n", calls, accepted);
    return 0;
}
