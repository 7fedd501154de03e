/* Saved states of an instance: copies, bytes, and what is refused of them; see fmu_core.h. */
#include "fmu_core.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* FNV-1a in 64 bits (Fowler, Noll and Vo): any single changed byte changes it. */
static uint64_t hash_of(const Saved *saved)
{
    const unsigned char *byte = (const unsigned char *)saved;
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    for (size_t i = sizeof saved->hash; i < sizeof *saved; i++)
        hash = (hash ^ byte[i]) * UINT64_C(0x100000001b3);
    return hash;
}

#define MOST_SAMPLES 9007199254740992.0 /* 2^53: every smaller count is a double */

static int is_mode(int mode)
{
    return mode == INSTANTIATED || mode == INITIALIZING || mode == STEPPING ||
           mode == TERMINATED || mode == EVENT || mode == CONTINUOUS;
}

static int check_saved(Fmu *fmu, const void *bytes, size_t size)
{
    Saved saved;
    const Memory *memory = &saved.memory;
    if (!bytes)
        return fmu_refuse(fmu, "There is no saved state.");
    if (size != sizeof saved)
        return fmu_refuse(fmu, "A saved state of this FMU has %u bytes, not %u.",
                          (unsigned)sizeof saved, (unsigned)size);
    memcpy(&saved, bytes, sizeof saved); /* the importer's bytes may lie unaligned */
    int mode = memory->mode;
    if (memcmp(saved.token, FMU_TOKEN, sizeof FMU_TOKEN) != 0)
        return fmu_refuse(fmu, "The saved state comes from another FMU.");
    if (saved.hash != hash_of(&saved) || isnan(memory->stop_s) || !(fabs(memory->start_s) <= LATEST_S) ||
        !(memory->samples >= 0.0 && memory->samples <= MOST_SAMPLES) || !is_mode(mode))
        return fmu_refuse(fmu, "The saved state is damaged.");
    if (mode & (fmu->exchange ? STEPPING : EVENT | CONTINUOUS))
        return fmu_refuse(fmu, "The saved state is of the other interface type.");
    if (!fmu_all_finite(memory->state, N_STATES))
        return fmu_refuse(fmu, "The saved state holds values that are not finite numbers.");
    for (size_t i = 0; i < FIRST_STATE; i++)
        if (!fmu_check_value(fmu, &VARIABLES[i], memory->value[i]))
            return 0;
    return 1;
}

int fmu_save(Fmu *fmu, Saved **saved)
{
    if (!*saved)
        *saved = calloc(1, sizeof **saved);
    if (!*saved)
        return fmu_refuse(fmu, "There is no memory left for a saved state.");
    memcpy((*saved)->token, FMU_TOKEN, sizeof FMU_TOKEN);
    (*saved)->memory = fmu->memory;
    (*saved)->hash = hash_of(*saved);
    return 1;
}

int fmu_restore(Fmu *fmu, const Saved *saved)
{
    if (!check_saved(fmu, saved, sizeof *saved))
        return 0;
    fmu->memory = saved->memory;
    fmu->memory.stale |= STALE_RATES | STALE_INDICATORS; /* they are not part of the memory */
    return 1;
}

void fmu_free_saved(void **saved)
{
    if (!saved)
        return;
    free(*saved);
    *saved = NULL;
}

int fmu_serialize(Fmu *fmu, const Saved *saved, void *bytes, size_t size)
{
    if (!check_saved(fmu, saved, size))
        return 0;
    memcpy(bytes, saved, size);
    return 1;
}

int fmu_deserialize(Fmu *fmu, const void *bytes, size_t size, Saved **saved)
{
    if (!check_saved(fmu, bytes, size) || !fmu_save(fmu, saved))
        return 0;
    memcpy(*saved, bytes, size);
    return 1;
}
