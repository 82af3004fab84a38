/* The kernel's own termios2, not libc's termios: only it knows baud rates that are not in a table (420000, 921600 ...).
 * Their headers exclude each other, hence <asm/termbits.h> here and no <termios.h>. */
#define _GNU_SOURCE
#include "tty.h"

#include <asm/ioctls.h>
#include <asm/termbits.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/serial.h>
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
static int set_line(struct termios2 *t, const struct settings *s)
{
    static const tcflag_t sizes[] = {CS5, CS6, CS7, CS8};

    if (s->speed == 0 || s->data_bits < 5 || s->data_bits > 8 || s->stop_bits < 1 || s->stop_bits > 2 ||
        s->parity >= PARITY_COUNT || s->flow >= FLOW_COUNT)
        return -EINVAL;

    t->c_iflag = IGNBRK;
    t->c_oflag = 0;
    t->c_lflag = 0;
    t->c_cflag &= ~(tcflag_t)(CSIZE | CSTOPB | PARENB | PARODD | CMSPAR | CRTSCTS | CBAUD | CIBAUD);
    t->c_cflag |= CREAD | CLOCAL | sizes[s->data_bits - 5];
    if (s->stop_bits == 2)
        t->c_cflag |= CSTOPB;

    if (s->parity != PARITY_NONE)
        t->c_cflag |= PARENB;
    if (s->parity == PARITY_ODD || s->parity == PARITY_MARK)
        t->c_cflag |= PARODD;
    if (s->parity == PARITY_SPACE || s->parity == PARITY_MARK)
        t->c_cflag |= CMSPAR;
    if (s->parity != PARITY_NONE && s->parity != PARITY_IGNORE)
        t->c_iflag |= INPCK;

    if (s->flow == FLOW_HARDWARE)
        t->c_cflag |= CRTSCTS;
    if (s->flow == FLOW_SOFTWARE)
        t->c_iflag |= IXON | IXOFF;
    t->c_cc[VSTART] = 0x11;
    t->c_cc[VSTOP] = 0x13;

    /* At least one byte: with zero, "no bytes" and "hung up" would look the same. */
    t->c_cc[VMIN] = 1;
    t->c_cc[VTIME] = 0;

    /* No bits for the input speed: it is the same as that of the output. */
    t->c_cflag |= speed_bits(s->speed);
    t->c_ispeed = s->speed;
    t->c_ospeed = s->speed;
    return 0;
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

static int set_rs485(int fd, const struct settings *s)
{
    static const struct {
        uint8_t bit;
        uint32_t flag;
    } flags[] = {
        {RS485_ENABLED, SER_RS485_ENABLED},
        {RS485_RTS_ON_SEND, SER_RS485_RTS_ON_SEND},
        {RS485_RTS_AFTER_SEND, SER_RS485_RTS_AFTER_SEND},
        {RS485_RX_DURING_TX, SER_RS485_RX_DURING_TX},
#ifdef SER_RS485_TERMINATE_BUS
        {RS485_TERMINATE_BUS, SER_RS485_TERMINATE_BUS},
#endif
    };

    /* Untouched unless given: some drivers return settings and then refuse the same ones. */
    if (s->rs485_given == 0)
        return 0;

#ifndef SER_RS485_TERMINATE_BUS
    if (s->rs485_given & RS485_TERMINATE_BUS)
        return -EINVAL;
#endif
    struct serial_rs485 r;
    memset(&r, 0, sizeof(r));
    if (ioctl(fd, TIOCGRS485, &r) < 0)
        return -errno;
    for (size_t i = 0; i < sizeof(flags) / sizeof(flags[0]); i++) {
        if (!(s->rs485_given & flags[i].bit))
            continue;
        r.flags &= ~flags[i].flag;
        if (s->rs485_values & flags[i].bit)
            r.flags |= flags[i].flag;
    }
    if (s->rs485_given & RS485_DELAY_BEFORE)
        r.delay_rts_before_send = s->rs485_delay_before;
    if (s->rs485_given & RS485_DELAY_AFTER)
        r.delay_rts_after_send = s->rs485_delay_after;
    return ioctl(fd, TIOCSRS485, &r) < 0 ? -errno : 0;
}

int tty_configure(int fd, const struct settings *s)
{
    struct termios2 before, wanted, now;
    bool plain;

    int rc = get_termios(fd, &before, &plain);
    if (rc < 0)
        return rc;
    wanted = before;
    if ((rc = set_line(&wanted, s)) < 0)
        return rc;

    rc = set_termios(fd, &wanted, plain);
    if (rc == 0 && !plain && (rc = get_termios(fd, &now, &plain)) == 0 && !speed_taken(&now, s->speed))
        rc = -EINVAL;
    if (rc == 0)
        rc = set_rs485(fd, s);
    if (rc < 0)
        set_termios(fd, &before, plain);
    return rc;
}

int tty_open(const char *path, const struct settings *s)
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
        rc = tty_configure(fd, s);
    if (rc < 0) {
        tty_close(fd);
        return rc;
    }
    /* Drop bytes from before, at whatever speed. */
    tty_flush(fd, QUEUE_RECEIVE);
    return fd;
}

void tty_close(int fd)
{
    /* A terminal that others hold, like a PTY, outlives us; its exclusive mode must not. */
    ioctl(fd, TIOCNXCL);
    close(fd);
}

int tty_flush(int fd, enum queue queue)
{
    static const int which[] = {[QUEUE_RECEIVE] = TCIFLUSH, [QUEUE_TRANSMIT] = TCOFLUSH, [QUEUE_BOTH] = TCIOFLUSH};
    return ioctl(fd, TCFLSH, which[queue]) < 0 ? -errno : 0;
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

int tty_signals(int fd, uint32_t *bits)
{
    static const struct {
        uint32_t bit;
        int flag;
    } lines[] = {
        {SIG_DTR, TIOCM_DTR}, {SIG_RTS, TIOCM_RTS}, {SIG_ST, TIOCM_ST},   {SIG_SR, TIOCM_SR},
        {SIG_CTS, TIOCM_CTS}, {SIG_CD, TIOCM_CAR},  {SIG_RNG, TIOCM_RNG}, {SIG_DSR, TIOCM_DSR},
    };
    int flags = 0;
    if (ioctl(fd, TIOCMGET, &flags) < 0)
        return -errno;

    *bits = 0;
    for (size_t i = 0; i < sizeof(lines) / sizeof(lines[0]); i++)
        if (flags & lines[i].flag)
            *bits |= lines[i].bit;
    return 0;
}

int tty_set(int fd, enum signal_line line, bool value)
{
    if (line == LINE_BREAK)
        return ioctl(fd, value ? TIOCSBRK : TIOCCBRK) < 0 ? -errno : 0;

    int flag = line == LINE_DTR ? TIOCM_DTR : TIOCM_RTS;
    return ioctl(fd, value ? TIOCMBIS : TIOCMBIC, &flag) < 0 ? -errno : 0;
}
