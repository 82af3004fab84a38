/*
 * The port program: one serial port, served for the BEAM over stdin and stdout (wire.h).
 *
 * One loop around poll; nothing else waits, so a port that accepts no bytes, or a read that gets none, never delays another
 * request or hides a hang-up. At most one read and one write or drain are pending: the BEAM's side queues the rest. The end of
 * stdin ends the program.
 */
#include "tty.h"
#include "wire.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define SETTINGS_SIZE 5
#define READ_SIZE 8192
#define PATH_SIZE 4096
/* The BEAM's side returns a credit for each packet of bytes that it has handled. */
#define FIRST_CREDIT 64
/* How often a drain checks how many bytes are left. */
#define DRAIN_TICK_MS 5

enum sending { IDLE, WRITING, DRAINING };

static struct {
    int fd; /* -1: closed */
    bool active;

    bool reading;
    uint32_t read_id;
    int64_t read_deadline;

    enum sending sending;
    uint32_t send_id;
    int64_t send_deadline;
    uint8_t bytes[WIRE_MAX];
    size_t sent, length;

    uint32_t credit;
} port = {.fd = -1, .credit = FIRST_CREDIT};

static int64_t now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000 + t.tv_nsec / 1000000;
}

static void die(const char *why)
{
    fprintf(stderr, "circuits_uart: %s\n", why);
    exit(2);
}

static bool fail_pending(int error)
{
    bool any = port.reading || port.sending != IDLE;
    if (port.reading)
        wire_error(port.read_id, error);
    if (port.sending != IDLE)
        wire_error(port.send_id, error);
    port.reading = false;
    port.sending = IDLE;
    return any;
}

/* The port failed. Whatever the kernel calls it, a device that is gone is EIO. */
static void gone(int error)
{
    if (error == ENODEV || error == ENXIO || error == EBADF)
        error = EIO;
    bool told = fail_pending(error);
    tty_close(port.fd);
    port.fd = -1;
    wire_gone(told, error);
}

/* Unsent bytes would delay close(), by up to half a minute on a line whose flow is stopped. */
static void close_now(int fd)
{
    if (tty_unsent(fd) > 0)
        tty_flush_unsent(fd);
    tty_close(fd);
}

static bool wants_bytes(void)
{
    return port.reading || (port.active && port.credit > 0);
}

static void do_read(bool hung_up)
{
    static uint8_t bytes[READ_SIZE];
    ssize_t n = read(port.fd, bytes, sizeof(bytes));

    if (n > 0 && port.reading) {
        port.reading = false;
        wire_ok(port.read_id, bytes, (size_t)n);
    } else if (n > 0) {
        port.credit--;
        wire_data(bytes, (size_t)n);
    } else if (n == 0) {
        gone(EIO);
    } else if (errno != EAGAIN && errno != EINTR) {
        gone(errno);
    } else if (errno == EAGAIN && hung_up) {
        gone(EIO);
    }
}

static void write_on(void)
{
    ssize_t n = write(port.fd, port.bytes + port.sent, port.length - port.sent);
    if (n >= 0)
        port.sent += (size_t)n;
    else if (errno != EAGAIN && errno != EINTR) {
        gone(errno);
        return;
    }
    if (port.sent == port.length) {
        port.sending = IDLE;
        wire_ok(port.send_id, NULL, 0);
    }
}

static void drain_on(void)
{
    if (tty_unsent(port.fd) > 0)
        return;
    int rc = tty_drain(port.fd);
    port.sending = IDLE;
    if (rc < 0)
        wire_error(port.send_id, -rc);
    else
        wire_ok(port.send_id, NULL, 0);
}

static void begin_sending(enum sending what, uint32_t id, uint32_t timeout_ms)
{
    if (port.sending != IDLE)
        die("a second write or drain while one is under way");
    port.sending = what;
    port.send_id = id;
    port.send_deadline = now_ms() + timeout_ms;
}

static void expire(void)
{
    int64_t now = now_ms();
    if (port.reading && now >= port.read_deadline) {
        port.reading = false;
        wire_ok(port.read_id, NULL, 0);
    }
    if (port.sending == DRAINING)
        drain_on();
    if (port.sending != IDLE && now >= port.send_deadline) {
        port.sending = IDLE;
        wire_error(port.send_id, EAGAIN);
    }
}

static int next_timeout(void)
{
    int64_t at = INT64_MAX, now = now_ms();
    if (port.reading)
        at = port.read_deadline;
    if (port.sending != IDLE && port.send_deadline < at)
        at = port.send_deadline;
    if (port.sending == DRAINING && now + DRAIN_TICK_MS < at)
        at = now + DRAIN_TICK_MS;
    if (at == INT64_MAX)
        return -1;
    if (at <= now)
        return 0;
    return at - now > INT32_MAX ? INT32_MAX : (int)(at - now);
}

static void do_open(uint32_t id, const uint8_t *args, size_t length)
{
    char path[PATH_SIZE];
    size_t path_length = length - SETTINGS_SIZE;

    fail_pending(ECANCELED);
    if (port.fd >= 0)
        close_now(port.fd);
    port.fd = -1;

    if (path_length == 0 || path_length >= sizeof(path) || memchr(args + SETTINGS_SIZE, 0, path_length)) {
        wire_error(id, ENOENT);
        return;
    }
    memcpy(path, args + SETTINGS_SIZE, path_length);
    path[path_length] = 0;

    int rc = tty_open(path, get_u32(args));
    if (rc < 0) {
        wire_error(id, -rc);
        return;
    }
    port.fd = rc;
    port.active = args[4];
    wire_ok(id, NULL, 0);
}

static void do_configure(uint32_t id, const uint8_t *args)
{
    int rc = tty_configure(port.fd, get_u32(args));
    if (rc < 0) {
        wire_error(id, -rc);
        return;
    }
    port.active = args[4];
    if (port.active && port.reading) {
        port.reading = false;
        wire_error(port.read_id, ECANCELED);
    }
    wire_ok(id, NULL, 0);
}

static void reply(uint32_t id, int rc)
{
    if (rc < 0)
        wire_error(id, -rc);
    else
        wire_ok(id, NULL, 0);
}

static void begin_read(uint32_t id, uint32_t timeout_ms)
{
    if (port.reading)
        die("a second read while one is under way");
    if (port.active) {
        wire_error(id, EINVAL);
        return;
    }
    port.reading = true;
    port.read_id = id;
    port.read_deadline = now_ms() + timeout_ms;
    do_read(false);
}

/* A malformed command ends the program: guessing could put wrong bytes on a line. */
static void expect(bool condition)
{
    if (!condition)
        die("malformed packet");
}

static void dispatch(const struct packet *p)
{
    if (p->length >= 1 && p->data[0] == CMD_CREDIT) {
        expect(p->length == 3);
        port.credit += get_u16(p->data + 1);
        return;
    }

    expect(p->length >= 5);
    uint32_t id = get_u32(p->data + 1);
    const uint8_t *args = p->data + 5;
    size_t length = p->length - 5;

    switch (p->data[0]) {
    case CMD_OPEN:
        expect(length >= SETTINGS_SIZE);
        do_open(id, args, length);
        return;
    case CMD_CANCEL:
        expect(length == 0);
        if (port.reading) {
            port.reading = false;
            wire_ok(port.read_id, NULL, 0);
        }
        return;
    default:
        break;
    }

    bool closed = port.fd < 0;
    switch (p->data[0]) {
    case CMD_CONFIGURE:
        expect(length == SETTINGS_SIZE);
        if (!closed)
            do_configure(id, args);
        break;
    case CMD_WRITE:
        expect(length >= 4);
        if (!closed) {
            begin_sending(WRITING, id, get_u32(args));
            port.sent = 0;
            port.length = length - 4;
            memcpy(port.bytes, args + 4, port.length);
            write_on();
        }
        break;
    case CMD_READ:
        expect(length == 4);
        if (!closed)
            begin_read(id, get_u32(args));
        break;
    case CMD_DRAIN:
        expect(length == 4);
        if (!closed) {
            begin_sending(DRAINING, id, get_u32(args));
            drain_on();
        }
        break;
    case CMD_FLUSH:
        expect(length == 0);
        if (!closed)
            reply(id, tty_flush_received(port.fd));
        break;
    default:
        die("unknown command");
    }
    if (closed)
        wire_error(id, EBADF);
}

static void serve_port(short events)
{
    bool hung_up = events & (POLLHUP | POLLERR | POLLNVAL);

    if ((events & POLLOUT) && port.sending == WRITING)
        write_on();
    if (port.fd >= 0 && ((events & POLLIN) || hung_up)) {
        if (wants_bytes())
            do_read(hung_up);
        else if (hung_up)
            gone(EIO);
    }
}

/* However the program ends: nobody waits for unsent bytes any more. */
static void release(void)
{
    if (port.fd >= 0)
        close_now(port.fd);
}

int main(void)
{
    atexit(release);
    /* Ctrl-C in the BEAM's shell is for the BEAM; it closes stdin when it ends. */
    signal(SIGINT, SIG_IGN);
    signal(SIGQUIT, SIG_IGN);
    signal(SIGHUP, SIG_IGN);
    signal(SIGPIPE, SIG_IGN);

    for (;;) {
        struct pollfd fds[2] = {{.fd = STDIN_FILENO, .events = POLLIN}, {.fd = port.fd, .events = 0}};
        if (wants_bytes())
            fds[1].events |= POLLIN;
        if (port.sending == WRITING)
            fds[1].events |= POLLOUT;

        int n = poll(fds, 2, next_timeout());
        if (n < 0 && errno != EINTR)
            die("poll failed");

        /* The port first: poll reported on the descriptor as it was before any command. */
        if (n > 0 && fds[1].revents)
            serve_port(fds[1].revents);
        if (n > 0 && fds[0].revents) {
            struct packet packet;
            if (!wire_fill())
                break;
            while (wire_next(&packet))
                dispatch(&packet);
        }
        expire();
    }

    return EXIT_SUCCESS;
}
