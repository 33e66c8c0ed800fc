/* Preloaded into a process: the n-th call that writes to a file fails with a chosen error. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static long calls, fatal = -1;
static int error_number; /* negative: a signal that kills the process in place of the call */

/* Count from now on; the call number `which`, from 0, fails. -1 lets all of them pass. */
void arm(long which, int number) {
    calls = 0;
    fatal = which;
    error_number = number;
}

long counted(void) { return calls; }

static int fails(void) {
    if (calls++ != fatal) return 0;
    if (error_number < 0) raise(-error_number);
    errno = error_number;
    return 1;
}

static int to_a_file(int fd) {
    struct stat found;
    return fd > 2 && fstat(fd, &found) == 0 && S_ISREG(found.st_mode);
}

static int opens_to_write(const char *path, int flags) {
    if (strncmp(path, "/dev/", 5) == 0 || strncmp(path, "/proc/", 6) == 0) return 0;
    return (flags & O_ACCMODE) != O_RDONLY || (flags & O_CREAT);
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define WRAP(type, name, parameters, arguments, watched) \
    type name parameters { return (watched) && fails() ? -1 : NEXT(name) arguments; }

WRAP(ssize_t, write, (int fd, const void *data, size_t size), (fd, data, size), to_a_file(fd))
WRAP(ssize_t, pwrite64, (int fd, const void *data, size_t size, off64_t at), (fd, data, size, at),
     to_a_file(fd))
WRAP(ssize_t, writev, (int fd, const struct iovec *parts, int count), (fd, parts, count),
     to_a_file(fd))
WRAP(int, ftruncate64, (int fd, off64_t size), (fd, size), to_a_file(fd))
WRAP(int, fsync, (int fd), (fd), to_a_file(fd))
WRAP(int, fchmod, (int fd, mode_t mode), (fd, mode), to_a_file(fd))
WRAP(int, rename, (const char *from, const char *to), (from, to), 1)
WRAP(int, link, (const char *from, const char *to), (from, to), 1)
WRAP(int, linkat, (int a, const char *from, int b, const char *to, int flags),
     (a, from, b, to, flags), 1)
WRAP(int, mkdir, (const char *path, mode_t mode), (path, mode), 1)

#define WRAP_OPEN(name)                                              \
    int name(const char *path, int flags, ...) {                     \
        va_list rest;                                                \
        va_start(rest, flags);                                       \
        mode_t mode = va_arg(rest, mode_t);                          \
        va_end(rest);                                                \
        if (opens_to_write(path, flags) && fails()) return -1;       \
        return NEXT(name)(path, flags, mode);                        \
    }

WRAP_OPEN(open)
WRAP_OPEN(open64)
