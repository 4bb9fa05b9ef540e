/* A clock that is not set, as a library to preload: the time of day begins in 1970 when the system starts, until the file
 * $CLOCK_IS_SET exists. */
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t id, struct timespec *t) {
    const char *is_set = getenv("CLOCK_IS_SET");
    if (id == CLOCK_REALTIME && is_set && access(is_set, F_OK) != 0)
        id = CLOCK_BOOTTIME;
    return (int)syscall(SYS_clock_gettime, id, t);
}
