/* A Kinect on an emulated usbfs, as a library to preload: the executable's real libusb talks to it by the system calls that
 * it talks to Linux with. Below $KINECT_ROOT stand the files of /sys/bus/usb/devices and /dev/bus/usb (the test lays them
 * out); opening a device node gives a descriptor whose ioctls are answered here, as drivers/usb/core/devio.c answers them.
 *
 * What the Kinect says comes from $KINECT_PLAY, a list of records {u8 endpoint, u8 0, u16 bytes, bytes}: commands (endpoint
 * 0x00), each followed by its reply (0x80), then packets of 0x81 and 0x82. Everything that it sees, and everything that a
 * real one would not have understood ("complaint"), goes to $KINECT_LOG, a line each.
 *
 * $KINECT_FAULTS: words `not_ready=N` (replies of 0 and 512 bytes by turns before each reply), `stale=N` (replies of an
 * earlier session that are still queued), `loss=N` (every Nth packet does not come: -EXDEV), `unplug=N` (the plug is pulled
 * after N packets), `replug=MS`, `deaf` (commands are never answered: the transfer hangs until it is cancelled), `full` (no
 * bandwidth for the second endpoint), `busy` (another program has claimed it), `k4w` (streams on alternate setting 1 only).
 *
 * Time goes on in microframes of 125 us, but never without a transfer to fill, so that no packet is lost by a busy machine.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/usbdevice_fs.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { CAMERA, MOTOR, PARTS };
static const char *const NODE[PARTS] = {"/dev/bus/usb/001/003", "/dev/bus/usb/001/004"};
static const char *const SYSFS[PARTS] = {"1-1.1", "1-1.2"};

struct urb {
    struct usbdevfs_urb *user;
    struct urb *next;
};
struct queue {
    struct urb *first, **last;
};
struct part {
    int fd, drain; /* the pipe whose write end is the descriptor: it is full unless there is something to reap */
    int claimed, driver, alternate, gone;
    struct queue waiting[3], done; /* waiting: control, 0x81, 0x82 */
};
static struct part parts[PARTS] = {{.fd = -1, .driver = 1}, {.fd = -1}};
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int uevents = -1;

struct record {
    uint8_t endpoint, reserved;
    uint16_t bytes;
    uint8_t data[];
};
static const uint8_t *play, *play_end, *next_packet[2];
static int stream_on[2], streaming, packets, pulled, last_tag = -1;
static uint8_t replies[64][512];
static int reply_bytes[64], reply_wait[64], reply_first, reply_count;

static void note(const char *format, ...) {
    char text[256];
    va_list args;
    va_start(args, format);
    int n = vsnprintf(text, sizeof text, format, args);
    va_end(args);
    int fd = syscall(SYS_openat, AT_FDCWD, getenv("KINECT_LOG"), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
    if (fd < 0 || write(fd, text, n) != n) abort();
    close(fd);
}

/* The number behind `name=`, or 1 for a bare `name`; 0 if it is not there. */
static int fault(const char *name) {
    const char *faults = getenv("KINECT_FAULTS"), *at = faults ? strstr(faults, name) : NULL;
    if (!at) return 0;
    at += strlen(name);
    return *at == '=' ? atoi(at + 1) : 1;
}

/* Queues */
static void put(struct queue *q, struct urb *u) {
    u->next = NULL;
    if (!q->first) q->last = &q->first;
    *q->last = u;
    q->last = &u->next;
}

static struct urb *take(struct queue *q) {
    struct urb *u = q->first;
    if (u) q->first = u->next;
    return u;
}

static struct urb *take_user(struct queue *q, void *user) {
    for (struct urb **at = &q->first; *at; at = &(*at)->next)
        if ((*at)->user == user) {
            struct urb *u = *at;
            *at = u->next;
            q->last = &q->first;
            while (*q->last) q->last = &(*q->last)->next;
            return u;
        }
    return NULL;
}

static void fill(struct part *p) {
    static char page[4096];
    while (write(p->fd, page, sizeof page) > 0) {}
}

static void complete(struct part *p, struct urb *u, int status) {
    char page[4096];
    u->user->status = status;
    put(&p->done, u);
    while (read(p->drain, page, sizeof page) > 0) {}
}

static void paths(char *now, char *away, int size, int part) {
    const char *root = getenv("KINECT_ROOT");
    snprintf(now, size, "%s/sys/bus/usb/devices/%s", root, SYSFS[part]);
    snprintf(away, size, "%s/gone-%s", root, SYSFS[part]);
}

static void unplug(void) {
    note("unplugged\n");
    for (int i = 0; i < PARTS; i++) {
        struct part *p = &parts[i];
        char now[512], away[512];
        paths(now, away, sizeof now, i);
        rename(now, away);
        if (p->fd < 0) continue;
        struct urb *u;
        for (int q = 0; q < 3; q++)
            while ((u = take(&p->waiting[q]))) complete(p, u, -ESHUTDOWN);
        p->gone = 1;
        close(p->drain); /* poll says POLLERR from now on */
        p->drain = -1;
    }
    stream_on[0] = stream_on[1] = 0;
}

static void *replug(void *unused) {
    usleep(1000 * fault("replug"));
    for (int i = 0; i < PARTS; i++) {
        char now[512], away[512];
        paths(now, away, sizeof now, i);
        rename(away, now);
    }
    pthread_mutex_lock(&lock);
    parts[CAMERA].driver = 1;
    note("plugged\n");
    pthread_mutex_unlock(&lock);
    return unused;
}

/* The stream's next packet, or NULL: 0 colour, 1 depth. */
static const struct record *packet(int stream) {
    while (next_packet[stream] < play_end) {
        const struct record *r = (const struct record *)next_packet[stream];
        next_packet[stream] += sizeof *r + r->bytes;
        if (r->endpoint == 0x81 + stream) return r;
    }
    return NULL;
}

/* The host controller: fills a transfer of each endpoint, 16 microframes long. */
static void *controller(void *unused) {
    struct timespec due;
    pthread_t thread;
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (;;) {
        if ((due.tv_nsec += 2000000) >= 1000000000) due.tv_nsec -= 1000000000, due.tv_sec++;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        pthread_mutex_lock(&lock);
        struct part *p = &parts[CAMERA];
        if (p->fd >= 0 && !p->gone && p->waiting[1].first && p->waiting[2].first)
            for (int stream = 0; stream < 2 && !p->gone; stream++) {
                struct urb *u = take(&p->waiting[1 + stream]);
                uint8_t *at = u->user->buffer;
                u->user->error_count = 0;
                for (int k = 0; k < u->user->number_of_packets; k++) {
                    struct usbdevfs_iso_packet_desc *d = &u->user->iso_frame_desc[k];
                    /* Colour has two packets for three of depth; the rest of its microframes are empty. */
                    const struct record *r = stream_on[stream] && (stream == 1 || k % 3 != 2) ? packet(stream) : NULL;
                    d->status = d->actual_length = 0;
                    if (r && fault("loss") && ++packets % fault("loss") == 0) {
                        note("lost %02x\n", r->endpoint);
                        d->status = -EXDEV;
                        u->user->error_count++;
                    } else if (r && r->bytes > d->length) {
                        note("complaint: transfers have room for %u bytes, a packet has %u\n", d->length, r->bytes);
                    } else if (r) {
                        memcpy(at, r->data, r->bytes);
                        d->actual_length = r->bytes;
                        streaming++;
                    }
                    at += d->length;
                }
                complete(p, u, 0);
                if (fault("unplug") && streaming >= fault("unplug") && !pulled++) {
                    unplug();
                    if (fault("replug")) pthread_create(&thread, NULL, replug, NULL);
                }
            }
        pthread_mutex_unlock(&lock);
    }
    return unused;
}

/* Queues a reply. */
static void answer(const uint8_t *bytes, int n, int tag, int wait) {
    if (reply_count == 64) return;
    int slot = (reply_first + reply_count++) % 64;
    memcpy(replies[slot], bytes, n);
    replies[slot][6] = tag, replies[slot][7] = tag >> 8;
    reply_bytes[slot] = n;
    reply_wait[slot] = wait;
}

/* A command of the camera: answered as the recorded one with the same payload. */
static void command(const uint8_t *c, int n) {
    int words = n >= 8 ? c[2] | c[3] << 8 : 0, code = n >= 8 ? c[4] | c[5] << 8 : 0, tag = n >= 8 ? c[6] | c[7] << 8 : 0;
    if (n < 8 || c[0] != 0x47 || c[1] != 0x4d || n != 8 + 2 * words) return note("complaint: malformed command\n");
    if (last_tag >= 0 && tag != ((last_tag + 1) & 0xffff)) note("complaint: tag %d after %d\n", tag, last_tag);
    last_tag = tag;
    if (code == 3) {
        int reg = c[8] | c[9] << 8, value = c[10] | c[11] << 8, stream = reg == 0x06;
        note("write %x=%x\n", reg, value);
        if ((reg == 0x05 || reg == 0x06) && (stream_on[stream] = value != 0) && !parts[CAMERA].waiting[1 + stream].first)
            note("complaint: stream %d started before its transfers were submitted\n", stream);
    }
    for (const uint8_t *at = play; at < play_end;) {
        const struct record *asked = (const struct record *)at, *reply;
        at += sizeof *asked + asked->bytes;
        if (asked->endpoint != 0x00 || asked->bytes != n || memcmp(asked->data + 8, c + 8, n - 8)) continue;
        if (asked->data[4] != c[4] || asked->data[5] != c[5]) continue;
        reply = (const struct record *)at;
        return answer(reply->data, reply->bytes, tag, fault("not_ready"));
    }
    note("complaint: command %x with payload %02x %02x is not known\n", code, n > 8 ? c[8] : 0, n > 9 ? c[9] : 0);
}

/* A control transfer: the setup packet and its data; returns the bytes that came in, or an error. */
static int control(int part, uint8_t *s) {
    int type = s[0], request = s[1], value = s[2] | s[3] << 8, index = s[4] | s[5] << 8, length = s[6] | s[7] << 8;
    uint8_t *data = s + 8;
    if (type == 0x80 && request == 6 && value >> 8 == 3) {
        static const char serial[] = "A00366A08793039A";
        if ((value & 0xff) == 0) return memcpy(data, "\4\3\11\4", 4), 4;
        data[0] = 2 * sizeof serial, data[1] = 3;
        for (unsigned i = 0; i + 1 < sizeof serial; i++) data[2 + 2 * i] = serial[i], data[3 + 2 * i] = 0;
        return 2 * sizeof serial;
    }
    if (part == MOTOR && type == 0x40 && request == 6) return note("led %d\n", value), length;
    if (part == MOTOR && type == 0xc0 && request == 0x32) return memcpy(data, "\0\0\0\0\x03\x33\0\0\0\0", 10), 10;
    if (part == CAMERA && type == 0x40 && request == 0 && value == 0 && index == 0) {
        return fault("deaf") ? -EINPROGRESS : (command(data, length), length);
    }
    if (part == CAMERA && type == 0xc0 && request == 0 && value == 0 && index == 0 && length == 0x200) {
        if (!reply_count) return 0;
        int slot = reply_first;
        if (reply_wait[slot] > 0) return memset(data, 0xee, 0x200), reply_wait[slot]-- % 2 ? 0 : 0x200;
        reply_first = (reply_first + 1) % 64, reply_count--;
        return memcpy(data, replies[slot], reply_bytes[slot]), reply_bytes[slot];
    }
    note("complaint: request %02x %02x value %x length %d to part %d\n", type, request, value, length, part);
    return -EPIPE;
}

static int submit(struct part *p, struct usbdevfs_urb *user) {
    int queue = user->type == USBDEVFS_URB_TYPE_CONTROL ? 0 : user->endpoint == 0x81 ? 1 : 2;
    int iso = user->type == USBDEVFS_URB_TYPE_ISO;
    if (queue && (!iso || !p->claimed || p != &parts[CAMERA])) return note("complaint: submitted unclaimed\n"), -EINVAL;
    if (iso && queue == 2 && fault("full")) return -ENOSPC;
    if (iso && fault("k4w") && p->alternate != 1) return note("complaint: submitted on setting %d\n", p->alternate), -ENOENT;
    struct urb *u = malloc(sizeof *u);
    u->user = user;
    if (iso) return put(&p->waiting[queue], u), 0;
    int n = control(p - parts, user->buffer);
    user->actual_length = n < 0 ? 0 : n;
    if (n == -EINPROGRESS) put(&p->waiting[0], u);
    else complete(p, u, n < 0 ? n : 0);
    return 0;
}

static int answer_ioctl(struct part *p, unsigned long request, void *arg) {
    struct urb *u;
    if (p->gone && request != USBDEVFS_REAPURBNDELAY) return -ENODEV;
    switch (request) {
    case USBDEVFS_GET_CAPABILITIES:
        *(uint32_t *)arg = USBDEVFS_CAP_ZERO_PACKET | USBDEVFS_CAP_NO_PACKET_SIZE_LIM | USBDEVFS_CAP_REAP_AFTER_DISCONNECT;
        return 0;
    case USBDEVFS_GETDRIVER:
        if (!p->driver) return -ENODATA;
        strcpy(((struct usbdevfs_getdriver *)arg)->driver, "gspca_kinect");
        return 0;
    case USBDEVFS_DISCONNECT_CLAIM:
        if (p->driver) note("detached\n");
        p->driver = 0; /* fall through */
    case USBDEVFS_CLAIMINTERFACE:
        if (p->driver || (fault("busy") && p == &parts[CAMERA])) return -EBUSY;
        if (p == &parts[CAMERA]) note("claimed\n");
        p->claimed = 1;
        return 0;
    case USBDEVFS_RELEASEINTERFACE:
        for (int q = 1; q < 3; q++)
            if (p->waiting[q].first) note("complaint: released with transfers in flight\n");
        if (p == &parts[CAMERA]) note("released\n");
        p->claimed = 0;
        return 0;
    case USBDEVFS_IOCTL:
        if (p != &parts[CAMERA]) return -ENODATA;
        if (((struct usbdevfs_ioctl *)arg)->ioctl_code != (int)USBDEVFS_CONNECT) return -ENODATA;
        note("attached\n");
        p->driver = 1;
        return 1;
    case USBDEVFS_SETINTERFACE:
        p->alternate = ((struct usbdevfs_setinterface *)arg)->altsetting;
        note("alternate %d\n", p->alternate);
        return 0;
    case USBDEVFS_SUBMITURB:
        return submit(p, arg);
    case USBDEVFS_DISCARDURB:
        for (int q = 0; q < 3; q++)
            if ((u = take_user(&p->waiting[q], arg))) return complete(p, u, -ENOENT), 0;
        return -EINVAL;
    case USBDEVFS_REAPURBNDELAY:
        if (!(u = take(&p->done))) {
            if (p->gone) return -ENODEV;
            fill(p);
            return -EAGAIN;
        }
        *(void **)arg = u->user;
        free(u);
        return 0;
    }
    note("complaint: ioctl %lx\n", request);
    return -ENOTTY;
}

int ioctl(int fd, unsigned long request, ...) {
    va_list args;
    va_start(args, request);
    void *arg = va_arg(args, void *);
    va_end(args);
    for (int i = 0; i < PARTS; i++)
        if (fd >= 0 && fd == parts[i].fd) {
            pthread_mutex_lock(&lock);
            int outcome = answer_ioctl(&parts[i], request, arg);
            pthread_mutex_unlock(&lock);
            if (outcome >= 0) return outcome;
            errno = -outcome;
            return -1;
        }
    return syscall(SYS_ioctl, fd, request, arg);
}

static void load(void) {
    static int loaded;
    if (loaded++) return;
    int fd = syscall(SYS_openat, AT_FDCWD, getenv("KINECT_PLAY"), O_RDONLY | O_CLOEXEC);
    struct stat s;
    if (fd < 0 || fstat(fd, &s)) abort();
    play = mmap(NULL, s.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
    close(fd);
    play_end = play + s.st_size;
    pthread_t thread;
    pthread_create(&thread, NULL, controller, NULL);
}

static int open_part(int i) {
    struct part *p = &parts[i];
    int ends[2];
    char now[512], away[512];
    paths(now, away, sizeof now, i);
    if (access(now, F_OK)) return errno = ENODEV, -1;
    if (p->fd >= 0) return errno = EMFILE, -1;
    load();
    if (pipe2(ends, O_NONBLOCK | O_CLOEXEC)) return -1;
    fcntl(ends[1], F_SETPIPE_SZ, 4096);
    p->fd = ends[1], p->drain = ends[0], p->gone = 0;
    fill(p);
    if (i == CAMERA) {
        static const uint8_t stale[10] = {0x52, 0x42, 1, 0, 3, 0};
        last_tag = -1, reply_first = reply_count = 0;
        next_packet[0] = next_packet[1] = play;
        for (int k = 0; k < fault("stale"); k++) answer(stale, 10, 1000 + k, 0);
    }
    return p->fd;
}

int close(int fd) {
    for (int i = 0; i < PARTS; i++)
        if (fd >= 0 && fd == parts[i].fd) {
            pthread_mutex_lock(&lock);
            parts[i].fd = -1;
            if (parts[i].drain >= 0) syscall(SYS_close, parts[i].drain);
            for (int q = 1; q < 3; q++)
                if (parts[i].waiting[q].first) note("complaint: closed with transfers in flight\n");
            pthread_mutex_unlock(&lock);
        }
    return syscall(SYS_close, fd);
}

/* Paths of USB lead below $KINECT_ROOT. */
static const char *redirected(const char *path, char *buffer, int size) {
    if (strncmp(path, "/sys/bus/usb/", 13) && strncmp(path, "/dev/bus/usb", 12)) return path;
    snprintf(buffer, size, "%s%s", getenv("KINECT_ROOT"), path);
    return buffer;
}

int open(const char *path, int flags, ...) {
    va_list args;
    va_start(args, flags);
    int mode = va_arg(args, int);
    va_end(args);
    for (int i = 0; i < PARTS; i++)
        if (!strcmp(path, NODE[i])) {
            pthread_mutex_lock(&lock);
            int fd = open_part(i);
            pthread_mutex_unlock(&lock);
            return fd;
        }
    char buffer[512];
    return syscall(SYS_openat, AT_FDCWD, redirected(path, buffer, sizeof buffer), flags, mode);
}

int open64(const char *path, int flags, ...) {
    va_list args;
    va_start(args, flags);
    int mode = va_arg(args, int);
    va_end(args);
    return open(path, flags, mode);
}

DIR *opendir(const char *path) {
    char buffer[512];
    DIR *(*real)(const char *) = (DIR *(*)(const char *))dlsym(RTLD_NEXT, "opendir");
    return real(redirected(path, buffer, sizeof buffer));
}

/* The kernel's news of plugging: a socket on which none ever comes. */
int socket(int domain, int type, int protocol) {
    if (domain != AF_NETLINK) return syscall(SYS_socket, domain, type, protocol);
    return uevents = syscall(SYS_socket, AF_UNIX, SOCK_DGRAM | (type & ~0xf), 0);
}

int bind(int fd, const struct sockaddr *address, socklen_t length) {
    return fd >= 0 && fd == uevents && address->sa_family == AF_NETLINK ? 0 : syscall(SYS_bind, fd, address, length);
}
