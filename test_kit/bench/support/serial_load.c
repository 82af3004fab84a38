/* One vehicle at the other end of a pseudo terminal, for bench/companion.exs.
 *
 *     serial_load RATE
 *
 * Prints the path of the terminal, then writes a heartbeat a second and beside it RATE frames of telemetry a second, evenly spaced. RATE 0 writes nothing at all. What the gateway writes is read and discarded. Ends with
 * its standard input.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include "frames.h"

static uint8_t seq;

int main(int argc, char **argv) {
  int rate = argc > 1 ? atoi(argv[1]) : 0, fd = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  uint8_t out[280], in[4096];
  struct termios raw;
  if (fd < 0 || grantpt(fd) || unlockpt(fd)) return 1;
  /* Kept open, so that the terminal stays while the gateway is away. */
  int keep = open(ptsname(fd), O_RDWR | O_NOCTTY);
  tcgetattr(keep, &raw);
  cfmakeraw(&raw);
  tcsetattr(keep, TCSANOW, &raw);
  printf("%s\n", ptsname(fd));
  fflush(stdout);

  uint64_t start = now_ns(), beats = 0;
  long sent = 0;
  struct pollfd from[2] = {{0, POLLIN, 0}, {fd, POLLIN, 0}};
  for (;;) {
    uint64_t now = now_ns(), due = start + 1000000000u * beats;
    if (rate > 0) {
      uint64_t next = start + (uint64_t)sent * 1000000000u / rate;
      if (now >= due) {
        ssize_t n = write(fd, out, heartbeat(out, seq++, 1, 1, 2, 3));
        (void)n;
        beats++;
      }
      if (now >= next) {
        ssize_t n = write(fd, out, telemetry(out, seq++, 1, sent % 1000, sent));
        sent++;
        (void)n;
        continue;
      }
      due = next < due ? next : due;
    } else {
      due = now + 1000000000u;
    }
    poll(from, 2, due > now ? (due - now) / 1000000 + 1 : 0);
    if (from[0].revents) return 0;
    if (from[1].revents & POLLIN) while (read(fd, in, sizeof in) > 0);
  }
}
