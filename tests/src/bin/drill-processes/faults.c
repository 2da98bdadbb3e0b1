/* Loaded into the processes of a run with LD_PRELOAD: lists the calls that change shared memory, sockets or the folder of
 * live runs, and at one of them kills the process, or fails the call.
 *
 * Environment:
 *   DRILL_LIST=FILE     append a line "PROGRAM OPERATION PATTERN" to FILE for each call
 *   DRILL_PROGRAM=NAME  the program to act in, by the start of its name
 *   DRILL_CALL=OPERATION PATTERN
 *   DRILL_NUMBER=N      at the N-th such call of a process
 *   DRILL_ACTION=WHAT   kill-before, kill-after, or the number of an error
 *   DRILL_TOKEN=FILE    created by the process that acts: only one does
 *   MEMTRANSFER_RUN_DIR the folder of live runs
 *
 * A pattern is a path with every run of hexadecimal digits that has a decimal one replaced by '#'.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <unistd.h>

enum action { NOTHING, KILL_AFTER, FAIL };

static const char *list_file, *target_call, *token_file, *action_word, *runs;
static long target_number;
static int acts_here, is_on;
static atomic_long seen;

__attribute__((constructor)) static void read_environment(void) {
    const char *program = getenv("DRILL_PROGRAM");
    list_file = getenv("DRILL_LIST");
    target_call = getenv("DRILL_CALL");
    token_file = getenv("DRILL_TOKEN");
    action_word = getenv("DRILL_ACTION");
    runs = getenv("MEMTRANSFER_RUN_DIR");
    const char *number = getenv("DRILL_NUMBER");
    target_number = number ? atol(number) : 0;
    acts_here = program && target_call && token_file && action_word && target_number > 0 &&
                strncmp(program_invocation_short_name, program, strlen(program)) == 0;
    is_on = acts_here || list_file;
}

/* Its own system calls, so that none of them is counted. */
static int raw_open(const char *path, int flags) {
    return (int)syscall(SYS_openat, AT_FDCWD, path, flags | O_CLOEXEC, 0600);
}

static int is_hex(char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); }

static void pattern_of(const char *path, char *out, size_t room) {
    size_t used = 0;
    while (*path && used + 1 < room) {
        size_t length = 0, digits = 0;
        while (is_hex(path[length])) {
            digits += path[length] <= '9';
            length++;
        }
        if (length > 0 && digits > 0) {
            out[used++] = '#';
            path += length;
        } else {
            size_t copied = length > 0 ? length : 1;
            for (size_t i = 0; i < copied && used + 1 < room; i++) out[used++] = path[i];
            path += copied;
        }
    }
    out[used] = 0;
}

static int is_in(const char *path, const char *folder) {
    size_t length = folder ? strlen(folder) : 0;
    return length > 0 && strncmp(path, folder, length) == 0 && path[length] == '/';
}

/* Other files are those of the run and the caches, whose faults are simulated. */
static int is_uninteresting(const char *path) {
    return !is_in(path, "/dev/shm") && !is_in(path, runs);
}

static void kill_self(void) {
    syscall(SYS_kill, getpid(), SIGKILL);
    for (;;) pause();
}

/* Counts a call; returns what is left to do, with errno set where it has to fail. */
static enum action at_path(const char *operation, const char *path) {
    char line[PATH_MAX + 64], pattern[PATH_MAX];
    int kept = errno;
    enum action action = NOTHING;
    if (!path || is_uninteresting(path)) return NOTHING;
    pattern_of(path, pattern, sizeof pattern);
    if (list_file) {
        int length = snprintf(line, sizeof line, "%s %s %s\n", program_invocation_short_name, operation, pattern);
        int fd = raw_open(list_file, O_WRONLY | O_APPEND | O_CREAT);
        if (fd >= 0) {
            syscall(SYS_write, fd, line, (size_t)length);
            syscall(SYS_close, fd);
        }
    }
    if (acts_here) {
        snprintf(line, sizeof line, "%s %s", operation, pattern);
        if (strcmp(line, target_call) == 0 && atomic_fetch_add(&seen, 1) + 1 == target_number) {
            int fd = raw_open(token_file, O_WRONLY | O_CREAT | O_EXCL);
            if (fd >= 0) {
                syscall(SYS_close, fd);
                if (strcmp(action_word, "kill-before") == 0) kill_self();
                if (strcmp(action_word, "kill-after") == 0) action = KILL_AFTER;
                else {
                    errno = atoi(action_word);
                    return FAIL;
                }
            }
        }
    }
    errno = kept;
    return action;
}

static enum action at_fd(const char *operation, int fd) {
    char link[64], path[PATH_MAX];
    int kept = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = syscall(SYS_readlink, link, path, sizeof path - 1);
    errno = kept;
    if (length <= 0) return NOTHING;
    path[length] = 0;
    return at_path(operation, path);
}

/* A shared memory name has a slash in front. */
static enum action at_segment(const char *operation, const char *name) {
    char path[PATH_MAX];
    snprintf(path, sizeof path, "/dev/shm/%s", name[0] == '/' ? name + 1 : name);
    return at_path(operation, path);
}

static enum action at_socket(const char *operation, const struct sockaddr *address) {
    if (!address || address->sa_family != AF_UNIX) return NOTHING;
    return at_path(operation, ((const struct sockaddr_un *)address)->sun_path);
}

#define ORIGINAL(type, name, ...)                                  \
    static type (*original)(__VA_ARGS__);                          \
    if (!original) original = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

#define CALL(type, counted, call)                 \
    do {                                          \
        enum action action = is_on ? counted : NOTHING; \
        if (action == FAIL) return -1;            \
        type result = call;                       \
        if (action == KILL_AFTER) kill_self();    \
        return result;                            \
    } while (0)

static int changes(int flags) { return flags & (O_CREAT | O_WRONLY | O_RDWR | O_TRUNC | O_APPEND); }

#define MODE(flags, mode)                                        \
    mode_t mode = 0;                                             \
    if ((flags) & (O_CREAT | O_TMPFILE)) {                       \
        va_list arguments;                                       \
        va_start(arguments, flags);                              \
        mode = (mode_t)va_arg(arguments, int);                   \
        va_end(arguments);                                       \
    }

int open(const char *path, int flags, ...) {
    ORIGINAL(int, "open", const char *, int, ...);
    MODE(flags, mode);
    CALL(int, changes(flags) ? at_path("open", path) : NOTHING, original(path, flags, mode));
}

int open64(const char *path, int flags, ...) {
    ORIGINAL(int, "open64", const char *, int, ...);
    MODE(flags, mode);
    CALL(int, changes(flags) ? at_path("open", path) : NOTHING, original(path, flags, mode));
}

int shm_open(const char *name, int flags, mode_t mode) {
    ORIGINAL(int, "shm_open", const char *, int, mode_t);
    CALL(int, (flags & O_CREAT) ? at_segment("shm_open", name) : NOTHING, original(name, flags, mode));
}

int shm_unlink(const char *name) {
    ORIGINAL(int, "shm_unlink", const char *);
    CALL(int, at_segment("shm_unlink", name), original(name));
}

int ftruncate(int fd, off_t length) {
    ORIGINAL(int, "ftruncate", int, off_t);
    CALL(int, at_fd("ftruncate", fd), original(fd, length));
}

int ftruncate64(int fd, off64_t length) {
    ORIGINAL(int, "ftruncate64", int, off64_t);
    CALL(int, at_fd("ftruncate", fd), original(fd, length));
}

int fchmod(int fd, mode_t mode) {
    ORIGINAL(int, "fchmod", int, mode_t);
    CALL(int, at_fd("fchmod", fd), original(fd, mode));
}

ssize_t write(int fd, const void *bytes, size_t length) {
    ORIGINAL(ssize_t, "write", int, const void *, size_t);
    CALL(ssize_t, at_fd("write", fd), original(fd, bytes, length));
}

int rename(const char *from, const char *to) {
    ORIGINAL(int, "rename", const char *, const char *);
    CALL(int, at_path("rename", to), original(from, to));
}

int unlink(const char *path) {
    ORIGINAL(int, "unlink", const char *);
    CALL(int, at_path("unlink", path), original(path));
}

int remove(const char *path) {
    ORIGINAL(int, "remove", const char *);
    CALL(int, at_path("unlink", path), original(path));
}

int mkdir(const char *path, mode_t mode) {
    ORIGINAL(int, "mkdir", const char *, mode_t);
    CALL(int, at_path("mkdir", path), original(path, mode));
}

int bind(int fd, const struct sockaddr *address, socklen_t length) {
    ORIGINAL(int, "bind", int, const struct sockaddr *, socklen_t);
    CALL(int, at_socket("bind", address), original(fd, address, length));
}

ssize_t sendto(int fd, const void *bytes, size_t length, int flags, const struct sockaddr *to, socklen_t to_length) {
    ORIGINAL(ssize_t, "sendto", int, const void *, size_t, int, const struct sockaddr *, socklen_t);
    CALL(ssize_t, at_socket("sendto", to), original(fd, bytes, length, flags, to, to_length));
}
