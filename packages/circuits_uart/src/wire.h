/*
 * The packets between the port program and the BEAM: a big-endian 16-bit length, then that many bytes, both ways.
 * The length field is the bound: no packet can be longer than the buffers here.
 *
 * From the BEAM:  <<command, id:32, arguments>>        CREDIT has no id, only <<CREDIT, count:16>>
 * To the BEAM:    <<'o', id:32, result>>               the request was done
 *                 <<'e', id:32, error name>>           the request failed; the name is a POSIX one, such as "enoent"
 *                 <<'d', bytes>>                       received in active mode; costs one credit
 *                 <<'g', told, error name>>            the port is gone (hung up, unplugged) and closed; told is 1 if
 *                                                      a waiting request failed with the same error
 */
#ifndef CIRCUITS_UART_WIRE_H
#define CIRCUITS_UART_WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define WIRE_MAX 65535

enum command {
    CMD_OPEN = 1,      /* <<settings, path>>; settings are <<speed:32, active: 0 or 1>> */
    CMD_CONFIGURE = 2, /* <<settings>> */
    CMD_WRITE = 3,     /* <<time-out in ms:32, bytes>> */
    CMD_READ = 4,      /* <<time-out in ms:32>> */
    CMD_CANCEL = 5,    /* answers the pending read, if any, without bytes */
    CMD_DRAIN = 6,     /* <<time-out in ms:32>> */
    CMD_FLUSH = 7,     /* drops received bytes that were not read */
    CMD_CREDIT = 8     /* <<count:16>> more packets of received bytes may be sent */
};

struct packet {
    const uint8_t *data;
    size_t length;
};

/* Reads what is available. False at the end of the stream: the BEAM has ended or closed the port. */
bool wire_fill(void);

/* Takes the next whole packet, valid until the next wire_fill. False if there is none. */
bool wire_next(struct packet *packet);

void wire_ok(uint32_t id, const void *result, size_t length);
void wire_error(uint32_t id, int error);
void wire_data(const void *bytes, size_t length);
void wire_gone(bool told, int error);

uint32_t get_u32(const uint8_t *bytes);
uint16_t get_u16(const uint8_t *bytes);

#endif
