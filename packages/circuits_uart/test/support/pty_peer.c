/*
 * The other side of a serial line, for tests: a PTY's master. Packets of a 16-bit length and then
 *
 *   in:   'w' bytes     write them (what the line does not take yet is kept)
 *         's' ispeed:32 bytes   the same, as long as the line has this speed; what is left at another speed is lost
 *         'p', 'r'      stop reading, go on reading
 *         't'           tell the line's settings as the slave side has them
 *         'x'           close the master: the slave is hung up
 *         'o'           open another PTY
 *         'u'           end the exclusive mode, as the last close of a real port does and that of a PTY does not
 *   out:  'n' path      of the slave, when a PTY was opened
 *         'd' bytes     received
 *         't' cflag:32 iflag:32 lflag:32 ispeed:32 ospeed:32 exclusive:8
 *         'x'           closed
 *
 * It holds the slave open too, so that a slave nobody else has open is no hang-up on this side.
 */
#define _GNU_SOURCE
#include <asm/ioctls.h>
#include <asm/termbits.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

static int master = -1, slave = -1;
static bool paused;
static uint8_t *unsent;
static size_t unsent_length;
/* The line's speed for which the unsent bytes are meant; 0 for any. */
static uint32_t unsent_speed;

static void send_packet(char type, const void *bytes, size_t length)
{
    static uint8_t out[2 + 65535];
    out[0] = (uint8_t)((length + 1) >> 8);
    out[1] = (uint8_t)(length + 1);
    out[2] = (uint8_t)type;
    memcpy(out + 3, bytes, length);
    for (size_t sent = 0; sent < length + 3;) {
        ssize_t n = write(1, out + sent, length + 3 - sent);
        if (n < 0 && errno != EINTR)
            exit(0);
        sent += n > 0 ? (size_t)n : 0;
    }
}

static void open_pty(void)
{
    char path[64];
    master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (master < 0 || grantpt(master) < 0 || unlockpt(master) < 0 || ptsname_r(master, path, sizeof(path)) != 0)
        exit(3);
    slave = open(path, O_RDWR | O_NOCTTY);
    if (slave < 0)
        exit(4);
    paused = false;
    send_packet('n', path, strlen(path));
}

static void close_pty(void)
{
    close(master);
    close(slave);
    master = slave = -1;
    unsent_length = 0;
    send_packet('x', "", 0);
}

static void put_u32(uint8_t *b, uint32_t v)
{
    b[0] = (uint8_t)(v >> 24), b[1] = (uint8_t)(v >> 16), b[2] = (uint8_t)(v >> 8), b[3] = (uint8_t)v;
}

static void tell_settings(void)
{
    uint8_t result[21];
    struct termios2 t;
    int exclusive = 0;
    if (ioctl(master, TCGETS2, &t) < 0 || ioctl(slave, TIOCGEXCL, &exclusive) < 0)
        exit(5);
    put_u32(result, t.c_cflag);
    put_u32(result + 4, t.c_iflag);
    put_u32(result + 8, t.c_lflag);
    put_u32(result + 12, t.c_ispeed);
    put_u32(result + 16, t.c_ospeed);
    result[20] = exclusive != 0;
    send_packet('t', result, sizeof(result));
}

static bool still_meant(void)
{
    struct termios2 t;
    if (unsent_speed != 0 && ioctl(master, TCGETS2, &t) < 0)
        exit(5);
    return unsent_speed == 0 || t.c_ispeed == unsent_speed;
}

static void keep(const uint8_t *bytes, size_t length)
{
    unsent = realloc(unsent, unsent_length + length + 1);
    if (unsent == NULL)
        exit(6);
    memcpy(unsent + unsent_length, bytes, length);
    unsent_length += length;
}

static void dispatch(const uint8_t *packet, size_t length)
{
    switch (length > 0 ? packet[0] : 0) {
    case 'w': unsent_speed = 0, keep(packet + 1, length - 1); break;
    case 's':
        if (length < 5)
            exit(7);
        unsent_speed = (uint32_t)packet[1] << 24 | (uint32_t)packet[2] << 16 | (uint32_t)packet[3] << 8 | packet[4];
        keep(packet + 5, length - 5);
        break;
    case 'p': paused = true; break;
    case 'r': paused = false; break;
    case 't': tell_settings(); break;
    case 'x': close_pty(); break;
    case 'o': open_pty(); break;
    case 'u': ioctl(slave, TIOCNXCL); break;
    default: exit(7);
    }
}

int main(void)
{
    static uint8_t in[2 * 65537], bytes[8192];
    size_t length = 0;
    open_pty();

    for (;;) {
        struct pollfd fds[2] = {{0, POLLIN, 0}, {master, 0, 0}};
        if (master >= 0)
            fds[1].events = (short)((paused ? 0 : POLLIN) | (unsent_length > 0 ? POLLOUT : 0));
        if (poll(fds, 2, -1) < 0)
            continue;

        if (fds[1].revents & POLLIN) {
            ssize_t n = read(master, bytes, sizeof(bytes));
            if (n > 0)
                send_packet('d', bytes, (size_t)n);
        }
        if (fds[1].revents & POLLOUT) {
            ssize_t n = still_meant() ? write(master, unsent, unsent_length) : (ssize_t)unsent_length;
            if (n > 0) {
                memmove(unsent, unsent + n, unsent_length - (size_t)n);
                unsent_length -= (size_t)n;
            }
        }
        if (fds[0].revents) {
            ssize_t n = read(0, in + length, sizeof(in) - length);
            if (n <= 0)
                return 0;
            length += (size_t)n;
            size_t at = 0;
            while (length - at >= 2 && length - at - 2 >= (size_t)(in[at] << 8 | in[at + 1])) {
                size_t size = (size_t)(in[at] << 8 | in[at + 1]);
                dispatch(in + at + 2, size);
                at += 2 + size;
            }
            memmove(in, in + at, length - at);
            length -= at;
        }
    }
}
