/* A serial port as a file descriptor: what termios2 and the terminal ioctls can do, with errors as negative errno. */
#ifndef CIRCUITS_UART_TTY_H
#define CIRCUITS_UART_TTY_H

#include <stdbool.h>
#include <stdint.h>

/* Opens for this process alone: -EAGAIN if another one holds the lock, -EBUSY if the kernel's exclusive mode is on. */
int tty_open(const char *path, uint32_t speed);
/* All or nothing: after an error the port is as before. */
/* Eight data bits, one stop bit, no parity, no flow control; any speed, in bits per second. */
int tty_configure(int fd, uint32_t speed);
void tty_close(int fd);
int tty_flush_received(int fd);
int tty_flush_unsent(int fd);
/* Unsent bytes in the kernel; 0 if that is not known. */
int tty_unsent(int fd);
/* Waits for the bytes in the device itself; call it when tty_unsent is 0, so that the wait is short. */
int tty_drain(int fd);

#endif
