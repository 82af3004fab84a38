/* A serial port as a file descriptor: what termios2 and the terminal ioctls can do, with errors as negative errno. */
#ifndef CIRCUITS_UART_TTY_H
#define CIRCUITS_UART_TTY_H

#include <stdbool.h>
#include <stdint.h>

enum parity { PARITY_NONE, PARITY_EVEN, PARITY_ODD, PARITY_SPACE, PARITY_MARK, PARITY_IGNORE, PARITY_COUNT };
enum flow { FLOW_NONE, FLOW_HARDWARE, FLOW_SOFTWARE, FLOW_COUNT };
enum queue { QUEUE_RECEIVE = 1, QUEUE_TRANSMIT = 2, QUEUE_BOTH = 3 };
enum signal_line { LINE_DTR = 1, LINE_RTS = 2, LINE_BREAK = 3 };

/* Bits of rs485_given (which of them the caller asked for) and rs485_values. */
enum rs485 {
    RS485_ENABLED = 1, RS485_RTS_ON_SEND = 2, RS485_RTS_AFTER_SEND = 4, RS485_RX_DURING_TX = 8,
    RS485_TERMINATE_BUS = 16, RS485_DELAY_BEFORE = 32, RS485_DELAY_AFTER = 64
};

/* Bits of tty_signals. */
enum signal_bit { SIG_DTR = 1, SIG_RTS = 2, SIG_ST = 4, SIG_SR = 8, SIG_CTS = 16, SIG_CD = 32, SIG_RNG = 64, SIG_DSR = 128 };

struct settings {
    uint32_t speed; /* bits per second, any */
    uint8_t data_bits, stop_bits, parity, flow;
    uint8_t rs485_given, rs485_values;
    uint32_t rs485_delay_before, rs485_delay_after; /* ms */
};

/* Opens for this process alone: -EAGAIN if another one holds the lock, -EBUSY if the kernel's exclusive mode is on. */
int tty_open(const char *path, const struct settings *settings);
/* All or nothing: after an error the port is as before. */
int tty_configure(int fd, const struct settings *settings);
void tty_close(int fd);
int tty_flush(int fd, enum queue queue);
/* Unsent bytes in the kernel; 0 if that is not known. */
int tty_unsent(int fd);
/* Waits for the bytes in the device itself; call it when tty_unsent is 0, so that the wait is short. */
int tty_drain(int fd);
int tty_signals(int fd, uint32_t *bits);
int tty_set(int fd, enum signal_line line, bool value);

#endif
