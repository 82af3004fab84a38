/* The kernel's own termios2, not libc's termios: only it knows baud rates that are not in a table (420000, 921600 ...).
 * Their headers exclude each other, hence <asm/termbits.h> here and no <termios.h>. */
#define _GNU_SOURCE
#include "tty.h"

#include <asm/ioctls.h>
#include <asm/termbits.h>
#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <unistd.h>

#ifndef TCGETS2 /* where the plain calls carry the speeds themselves (PowerPC, Alpha) */
#define TCGETS2 TCGETS
#define TCSETS2 TCSETS
#define termios2 termios
#endif

static const struct {
    uint32_t speed;
    tcflag_t bits;
} standard[] = {
    {50, B50},           {75, B75},           {110, B110},         {134, B134},         {150, B150},
    {200, B200},         {300, B300},         {600, B600},         {1200, B1200},       {1800, B1800},
    {2400, B2400},       {4800, B4800},       {9600, B9600},       {19200, B19200},     {38400, B38400},
    {57600, B57600},     {115200, B115200},   {230400, B230400},   {460800, B460800},   {500000, B500000},
    {576000, B576000},   {921600, B921600},   {1000000, B1000000}, {1152000, B1152000}, {1500000, B1500000},
    {2000000, B2000000}, {2500000, B2500000}, {3000000, B3000000}, {3500000, B3500000}, {4000000, B4000000},
};

/* The named constant if there is one, so that other programs understand the port's settings. */
static tcflag_t speed_bits(uint32_t speed)
{
    for (size_t i = 0; i < sizeof(standard) / sizeof(standard[0]); i++)
        if (standard[i].speed == speed)
            return standard[i].bits;
    return BOTHER;
}

/* Raw bytes both ways, whatever the settings before; those that do not concern the line (HUPCL) stay. */
static void set_line(struct termios2 *t, uint32_t speed)
{
    t->c_iflag = IGNBRK;
    t->c_oflag = 0;
    t->c_lflag = 0;
    t->c_cflag &= ~(tcflag_t)(CSIZE | CSTOPB | PARENB | PARODD | CMSPAR | CRTSCTS | CBAUD | CIBAUD);
    t->c_cflag |= CREAD | CLOCAL | CS8;

    /* At least one byte: with zero, "no bytes" and "hung up" would look the same. */
    t->c_cc[VMIN] = 1;
    t->c_cc[VTIME] = 0;

    /* No bits for the input speed: it is the same as that of the output. */
    t->c_cflag |= speed_bits(speed);
    t->c_ispeed = speed;
    t->c_ospeed = speed;
}

static int get_termios(int fd, struct termios2 *t, bool *plain)
{
    *plain = false;
    if (ioctl(fd, TCGETS2, t) == 0)
        return 0;

    struct termios old;
    if (ioctl(fd, TCGETS, &old) < 0)
        return -errno;
    *plain = true;
    memset(t, 0, sizeof(*t));
    t->c_iflag = old.c_iflag;
    t->c_oflag = old.c_oflag;
    t->c_cflag = old.c_cflag;
    t->c_lflag = old.c_lflag;
    t->c_line = old.c_line;
    memcpy(t->c_cc, old.c_cc, sizeof(old.c_cc));
    return 0;
}

static int set_termios(int fd, const struct termios2 *t, bool plain)
{
    if (!plain)
        return ioctl(fd, TCSETS2, t) < 0 ? -errno : 0;
    if ((t->c_cflag & CBAUD) == BOTHER)
        return -EINVAL;

    struct termios old;
    memset(&old, 0, sizeof(old));
    old.c_iflag = t->c_iflag;
    old.c_oflag = t->c_oflag;
    old.c_cflag = t->c_cflag;
    old.c_lflag = t->c_lflag;
    old.c_line = t->c_line;
    memcpy(old.c_cc, t->c_cc, sizeof(old.c_cc));
    return ioctl(fd, TCSETS, &old) < 0 ? -errno : 0;
}

/* A driver that does not support a rate silently keeps another one. No receiver tolerates five percent. */
static bool speed_taken(const struct termios2 *now, uint32_t wanted)
{
    uint64_t has = now->c_ospeed;
    return has == 0 || (has * 100 >= (uint64_t)wanted * 95 && has * 100 <= (uint64_t)wanted * 105);
}

int tty_configure(int fd, uint32_t speed)
{
    struct termios2 before, wanted, now;
    bool plain;

    if (speed == 0)
        return -EINVAL;
    int rc = get_termios(fd, &before, &plain);
    if (rc < 0)
        return rc;
    wanted = before;
    set_line(&wanted, speed);

    rc = set_termios(fd, &wanted, plain);
    if (rc == 0 && !plain && (rc = get_termios(fd, &now, &plain)) == 0 && !speed_taken(&now, speed))
        rc = -EINVAL;
    if (rc < 0)
        set_termios(fd, &before, plain);
    return rc;
}

int tty_open(const char *path, uint32_t speed)
{
    int fd = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0)
        return -errno;

    struct termios2 t;
    bool plain;
    int rc = get_termios(fd, &t, &plain);
    /* The lock keeps out programs that check locks, and decides who was first; the exclusive mode keeps out all others. */
    if (rc == 0 && flock(fd, LOCK_EX | LOCK_NB) < 0)
        rc = -errno;
    if (rc < 0) {
        close(fd);
        return rc;
    }

    if (ioctl(fd, TIOCEXCL) < 0)
        rc = -errno;
    if (rc == 0)
        rc = tty_configure(fd, speed);
    if (rc < 0) {
        tty_close(fd);
        return rc;
    }
    /* Drop bytes from before, at whatever speed. */
    tty_flush_received(fd);
    return fd;
}

void tty_close(int fd)
{
    /* A terminal that others hold, like a PTY, outlives us; its exclusive mode must not. */
    ioctl(fd, TIOCNXCL);
    close(fd);
}

int tty_flush_received(int fd)
{
    return ioctl(fd, TCFLSH, TCIFLUSH) < 0 ? -errno : 0;
}

int tty_flush_unsent(int fd)
{
    return ioctl(fd, TCFLSH, TCOFLUSH) < 0 ? -errno : 0;
}

int tty_unsent(int fd)
{
    int count = 0;
    return ioctl(fd, TIOCOUTQ, &count) < 0 ? 0 : count;
}

int tty_drain(int fd)
{
    return ioctl(fd, TCSBRK, 1) < 0 ? -errno : 0;
}
