/* Probe: wake at absolute times and record the time, the lateness, and the processor time that this
 * program's own processes used meanwhile.
 *
 * In C because a probe in Python would delay the observed loop every millisecond. */
#define _GNU_SOURCE
#include <poll.h>
#include <stdint.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

enum { WAKE, LATENESS, OWN, COLUMNS };

static int64_t read_clock(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * INT64_C(1000000000) + t.tv_nsec;
}

/* Processor time of this thread and of the processes whose schedstat files are open. */
static int64_t spent_ns(const int *accounts, int count) {
    int64_t spent = read_clock(CLOCK_THREAD_CPUTIME_ID);
    for (int k = 0; k < count; k++) {
        char text[64];
        ssize_t length = pread(accounts[k], text, sizeof text - 1, 0);
        if (length > 0) { /* it may have ended */
            text[length] = '\0';
            spent += strtoll(text, NULL, 10);
        }
    }
    return spent;
}

/* Fill rows until they are full or `stop_fd` becomes readable; return how many were filled.
 * `state` carries the last deadline and the time spent from one call to the next; zeros begin. */
__attribute__((visibility("default")))
int64_t watch(int stop_fd, int64_t period_ns, const int *accounts, int count, int64_t state[2],
              int64_t (*rows)[COLUMNS], int64_t capacity) {
    struct pollfd stop = {.fd = stop_fd, .events = POLLIN};
    int64_t deadline_ns = state[0], before_ns = state[1];
    if (deadline_ns == 0) {
        deadline_ns = read_clock(CLOCK_MONOTONIC);
        before_ns = spent_ns(accounts, count);
    }
    int64_t filled = 0;
    while (filled < capacity && poll(&stop, 1, 0) == 0) {
        deadline_ns += period_ns;
        struct timespec until = {.tv_sec = deadline_ns / 1000000000,
                                 .tv_nsec = deadline_ns % 1000000000};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) != 0) {
        }
        int64_t now_ns = read_clock(CLOCK_MONOTONIC), after_ns = spent_ns(accounts, count);
        int64_t *row = rows[filled++];
        row[WAKE] = now_ns;
        row[LATENESS] = now_ns - deadline_ns;
        row[OWN] = after_ns - before_ns;
        before_ns = after_ns;
        if (row[LATENESS] > period_ns) /* keep the phase, do not catch up */
            deadline_ns += row[LATENESS] / period_ns * period_ns;
    }
    state[0] = deadline_ns;
    state[1] = before_ns;
    return filled;
}
