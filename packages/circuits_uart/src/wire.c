#include "wire.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define HEADER 2

/* Room for one whole packet and the beginning of the next, so that wire_fill always has room to read into. */
static uint8_t in[2 * (HEADER + WIRE_MAX)];
static size_t in_start, in_end;

static uint8_t out[HEADER + WIRE_MAX];

static const struct {
    int error;
    const char *name;
} names[] = {
    {EPERM, "eperm"},   {ENOENT, "enoent"}, {EINTR, "eintr"},         {EIO, "eio"},           {ENXIO, "enxio"},
    {EBADF, "ebadf"},   {EAGAIN, "eagain"}, {ENOMEM, "enomem"},       {EACCES, "eacces"},     {EBUSY, "ebusy"},
    {ENODEV, "enodev"}, {ENOTDIR, "enotdir"}, {EISDIR, "eisdir"},     {EINVAL, "einval"},     {ENFILE, "enfile"},
    {EMFILE, "emfile"}, {ENOTTY, "enotty"}, {EROFS, "erofs"},         {ELOOP, "eloop"},       {ECANCELED, "ecanceled"},
    {EOPNOTSUPP, "eopnotsupp"},             {ENAMETOOLONG, "enametoolong"},                   {ETIMEDOUT, "etimedout"},
};

static const char *error_name(int error)
{
    for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); i++)
        if (names[i].error == error)
            return names[i].name;
    return "einval";
}

uint16_t get_u16(const uint8_t *b) { return (uint16_t)(b[0] << 8 | b[1]); }

uint32_t get_u32(const uint8_t *b)
{
    return (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3];
}

static void put_u32(uint8_t *b, uint32_t value)
{
    b[0] = (uint8_t)(value >> 24);
    b[1] = (uint8_t)(value >> 16);
    b[2] = (uint8_t)(value >> 8);
    b[3] = (uint8_t)value;
}

bool wire_fill(void)
{
    memmove(in, in + in_start, in_end - in_start);
    in_end -= in_start;
    in_start = 0;

    ssize_t n;
    do
        n = read(STDIN_FILENO, in + in_end, sizeof(in) - in_end);
    while (n < 0 && errno == EINTR);

    if (n < 0 && errno == EAGAIN)
        return true;
    if (n <= 0)
        return false;
    in_end += (size_t)n;
    return true;
}

bool wire_next(struct packet *packet)
{
    size_t have = in_end - in_start;
    if (have < HEADER)
        return false;
    size_t length = get_u16(in + in_start);
    if (have < HEADER + length)
        return false;

    packet->data = in + in_start + HEADER;
    packet->length = length;
    in_start += HEADER + length;
    return true;
}

/* Sends what follows the header in `out`. Blocks while the pipe is full, which only the BEAM can end; without a BEAM
 * there is nobody to serve. */
static void send_out(size_t length)
{
    out[0] = (uint8_t)(length >> 8);
    out[1] = (uint8_t)length;
    for (size_t sent = 0; sent < HEADER + length;) {
        ssize_t n = write(STDOUT_FILENO, out + sent, HEADER + length - sent);
        if (n >= 0)
            sent += (size_t)n;
        else if (errno != EINTR)
            exit(EXIT_SUCCESS);
    }
}

static size_t append(size_t at, const void *bytes, size_t length)
{
    if (length > WIRE_MAX - at)
        length = WIRE_MAX - at;
    if (length > 0)
        memcpy(out + HEADER + at, bytes, length);
    return at + length;
}

void wire_ok(uint32_t id, const void *result, size_t length)
{
    out[HEADER] = 'o';
    put_u32(out + HEADER + 1, id);
    send_out(append(5, result, length));
}

void wire_error(uint32_t id, int error)
{
    const char *name = error_name(error);
    out[HEADER] = 'e';
    put_u32(out + HEADER + 1, id);
    send_out(append(5, name, strlen(name)));
}

void wire_data(const void *bytes, size_t length)
{
    out[HEADER] = 'd';
    send_out(append(1, bytes, length));
}

void wire_gone(bool told, int error)
{
    const char *name = error_name(error);
    out[HEADER] = 'g';
    out[HEADER + 1] = told;
    send_out(append(2, name, strlen(name)));
}
