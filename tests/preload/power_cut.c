/* Cuts the power at a write or a change of a name, as a library to preload. Every such operation below $CUT_ROOT is numbered; number
 * $CUT_AT kills the process group instead (a write has written half of its bytes by then). What happened before stands in $CUT_LOG, a
 * line each, so that a test can take back what was not on the disk yet:
 *
 *   create PATH | mkdir PATH | write PATH | cut PATH LENGTH | sync PATH LENGTH | syncdir PATH
 *   rename OLD NEW KEPT | unlink PATH KEPT | rmdir PATH
 *
 * KEPT is a second name of what was replaced or removed, below $CUT_KEEP; `-` if there was nothing. status.json is of no interest. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static const char *root, *keep;
static int log_fd = -1;
static long cut_at, operations, kept;

__attribute__((constructor)) static void begin(void) {
    root = getenv("CUT_ROOT");
    keep = getenv("CUT_KEEP");
    const char *path = getenv("CUT_LOG"), *at = getenv("CUT_AT");
    cut_at = at ? atol(at) : 0;
    if (root && path)
        log_fd = (int)syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

/* Whether the path is watched. */
static int watched(const char *path) {
    size_t n = root ? strlen(root) : 0;
    return log_fd >= 0 && n && strncmp(path, root, n) == 0 && path[n] == '/' && !strstr(path, "/status.json");
}

static int path_of(int fd, char out[PATH_MAX]) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, out, PATH_MAX - 1);
    out[n < 0 ? 0 : n] = 0;
    return n > 0 && watched(out);
}

static int path_at(int fd, const char *path, char out[PATH_MAX]) {
    if (path[0] == '/' || fd == AT_FDCWD) {
        snprintf(out, PATH_MAX, "%s", path);
    } else {
        char folder[PATH_MAX];
        path_of(fd, folder);
        if (snprintf(out, PATH_MAX, "%s/%s", folder, path) >= PATH_MAX)
            return 0;
    }
    return watched(out);
}

/* Counts an operation; true if the power fails here. */
static int fails(void) { return ++operations == cut_at; }

static void die(void) {
    kill(0, SIGKILL);
    for (;;)
        pause();
}

static void say(const char *format, ...) {
    char line[3 * PATH_MAX];
    va_list arguments;
    va_start(arguments, format);
    int n = vsnprintf(line, sizeof line, format, arguments);
    va_end(arguments);
    if (n < 0 || syscall(SYS_write, log_fd, line, (size_t)n) != n)
        abort();
}

/* Keeps a file that is about to lose its name. */
static void keep_file(const char *path, char name[PATH_MAX]) {
    struct stat s;
    strcpy(name, "-");
    if (lstat(path, &s) == 0 && S_ISREG(s.st_mode)) {
        snprintf(name, PATH_MAX, "%s/%ld", keep, ++kept);
        if (syscall(SYS_linkat, AT_FDCWD, path, AT_FDCWD, name, 0) != 0)
            abort();
    }
}

static int open_at(int dir, const char *path, int flags, mode_t mode) {
    char full[PATH_MAX];
    struct stat s;
    if (!(flags & (O_CREAT | O_TRUNC)) || !path_at(dir, path, full))
        return (int)syscall(SYS_openat, dir, path, flags, mode);
    pthread_mutex_lock(&lock);
    int is_new = lstat(full, &s) != 0;
    if ((is_new || flags & O_TRUNC) && fails())
        die();
    int fd = (int)syscall(SYS_openat, dir, path, flags, mode);
    if (fd >= 0 && is_new)
        say("create\t%s\n", full);
    else if (fd >= 0 && flags & O_TRUNC)
        say("cut\t%s\t0\n", full);
    pthread_mutex_unlock(&lock);
    return fd;
}

#define OPEN(name, parameters, dir)                                                                                                    \
    int name parameters {                                                                                                              \
        mode_t mode = 0;                                                                                                               \
        if (flags & (O_CREAT | O_TMPFILE)) {                                                                                           \
            va_list arguments;                                                                                                         \
            va_start(arguments, flags);                                                                                                \
            mode = va_arg(arguments, mode_t);                                                                                          \
            va_end(arguments);                                                                                                         \
        }                                                                                                                              \
        return open_at(dir, path, flags, mode);                                                                                        \
    }
OPEN(open, (const char *path, int flags, ...), AT_FDCWD)
OPEN(open64, (const char *path, int flags, ...), AT_FDCWD)
OPEN(openat, (int dir, const char *path, int flags, ...), dir)
OPEN(openat64, (int dir, const char *path, int flags, ...), dir)

ssize_t write(int fd, const void *bytes, size_t n) {
    char path[PATH_MAX];
    if (fd <= 2 || !path_of(fd, path))
        return syscall(SYS_write, fd, bytes, n);
    pthread_mutex_lock(&lock);
    if (fails()) {
        say("write\t%s\n", path);
        syscall(SYS_write, fd, bytes, n / 2);
        die();
    }
    ssize_t done = syscall(SYS_write, fd, bytes, n);
    say("write\t%s\n", path);
    pthread_mutex_unlock(&lock);
    return done;
}

static int truncate_fd(int fd, off_t length) {
    char path[PATH_MAX];
    if (!path_of(fd, path))
        return (int)syscall(SYS_ftruncate, fd, length);
    pthread_mutex_lock(&lock);
    if (fails())
        die();
    int done = (int)syscall(SYS_ftruncate, fd, length);
    say("cut\t%s\t%ld\n", path, (long)length);
    pthread_mutex_unlock(&lock);
    return done;
}
int ftruncate(int fd, off_t length) { return truncate_fd(fd, length); }
int ftruncate64(int fd, off64_t length) { return truncate_fd(fd, length); }

static int sync_fd(int fd, long call) {
    char path[PATH_MAX];
    struct stat s;
    if (!root || !path_of(fd, path) || fstat(fd, &s) != 0) {
        /* The device folder itself has no path below it. */
        if (!root || strcmp(path, root) != 0)
            return (int)syscall(call, fd);
        s.st_mode = S_IFDIR;
    }
    pthread_mutex_lock(&lock);
    if (fails())
        die();
    /* The test says what was on the disk: the real one need not be waited for. */
    if (S_ISDIR(s.st_mode))
        say("syncdir\t%s\n", path);
    else
        say("sync\t%s\t%ld\n", path, (long)s.st_size);
    pthread_mutex_unlock(&lock);
    return 0;
}
int fsync(int fd) { return sync_fd(fd, SYS_fsync); }
int fdatasync(int fd) { return sync_fd(fd, SYS_fdatasync); }

int rename(const char *old, const char *new) {
    char name[PATH_MAX];
    if (!watched(new))
        return (int)syscall(SYS_renameat2, AT_FDCWD, old, AT_FDCWD, new, 0);
    pthread_mutex_lock(&lock);
    if (fails())
        die();
    keep_file(new, name);
    int done = (int)syscall(SYS_renameat2, AT_FDCWD, old, AT_FDCWD, new, 0);
    if (done == 0)
        say("rename\t%s\t%s\t%s\n", old, new, name);
    pthread_mutex_unlock(&lock);
    return done;
}

int unlinkat(int dir, const char *path, int flags) {
    char full[PATH_MAX], name[PATH_MAX];
    if (!path_at(dir, path, full))
        return (int)syscall(SYS_unlinkat, dir, path, flags);
    pthread_mutex_lock(&lock);
    if (fails())
        die();
    keep_file(full, name);
    int done = (int)syscall(SYS_unlinkat, dir, path, flags);
    int error = errno;
    if (done == 0 && flags & AT_REMOVEDIR)
        say("rmdir\t%s\n", full);
    else if (done == 0)
        say("unlink\t%s\t%s\n", full, name);
    pthread_mutex_unlock(&lock);
    errno = error;
    return done;
}
int unlink(const char *path) { return unlinkat(AT_FDCWD, path, 0); }
int rmdir(const char *path) { return unlinkat(AT_FDCWD, path, AT_REMOVEDIR); }

int mkdir(const char *path, mode_t mode) {
    if (!watched(path))
        return (int)syscall(SYS_mkdirat, AT_FDCWD, path, mode);
    pthread_mutex_lock(&lock);
    if (fails())
        die();
    int done = (int)syscall(SYS_mkdirat, AT_FDCWD, path, mode);
    int error = errno;
    if (done == 0)
        say("mkdir\t%s\n", path);
    pthread_mutex_unlock(&lock);
    errno = error;
    return done;
}
