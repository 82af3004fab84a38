/* Vehicles, each from a socket of its own, and made-up senders beside them.
 *
 *     vehicle_load PORT VEHICLES LINKS RATE SECONDS FAKES [WATCHED]
 *
 * Vehicle i (system i / LINKS + 1) says RATE frames a second to 127.0.0.1:(PORT + i % LINKS), evenly spaced: a heartbeat a
 * second, else telemetry (frames.h). FAKES heartbeats a second come from ever new addresses (127.x.y.z) and ports,
 * each one of another system, autopilots and ground stations in turn. The first WATCHED vehicles of each link change their mode with each
 * heartbeat: custom_mode is that clock, too.
 *
 * Prints how many frames other than heartbeats were sent, and how long it took.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <unistd.h>

#include "frames.h"

#define MAX_VEHICLES 2000

static int vehicles, links, port, fakes, watched, fd[MAX_VEHICLES];
static uint8_t seq[MAX_VEHICLES];
static volatile int done;

static struct sockaddr_in address(uint32_t host, int p) {
  struct sockaddr_in a = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(host), .sin_port = htons(p)};
  return a;
}

static void wait_until(uint64_t due) {
  struct timespec t = {due / 1000000000u, due % 1000000000u};
  if (now_ns() < due) clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

static void *make_up(void *unused) {
  (void)unused;
  uint8_t bytes[64];
  uint64_t start = now_ns();
  for (long n = 0; !done; n++) {
    wait_until(start + n * 1000000000u / fakes);
    int s = socket(AF_INET, SOCK_DGRAM, 0);
    struct sockaddr_in from = address(0x7f000000 | (rand() & 0xffff00) | 2, 0), to = address(0x7f000001, port + n % links);
    bind(s, (struct sockaddr *)&from, sizeof from);
    int size = n % 2 ? heartbeat(bytes, 0, rand() % 250 + 1, 1, 2, 3) : heartbeat(bytes, 0, rand() % 250 + 1, 190, 6, 8);
    sendto(s, bytes, size, 0, (struct sockaddr *)&to, sizeof to);
    close(s);
  }
  return NULL;
}

int main(int count, char **words) {
  if (count < 7) return 2;
  port = atoi(words[1]), vehicles = atoi(words[2]), links = atoi(words[3]), fakes = atoi(words[6]);
  watched = count > 7 ? atoi(words[7]) : 0;
  double rate = atof(words[4]), seconds = atof(words[5]);
  if (vehicles > MAX_VEHICLES) return 2;

  for (int i = 0; i < vehicles; i++) {
    struct sockaddr_in from = address(0x7f000001, port + 1000 + i), to = address(0x7f000001, port + i % links);
    fd[i] = socket(AF_INET, SOCK_DGRAM, 0);
    /* The same ones in each run, or they are further peers. */
    if (bind(fd[i], (struct sockaddr *)&from, sizeof from)) return 3;
    if (connect(fd[i], (struct sockaddr *)&to, sizeof to)) return 3;
  }

  pthread_t thread;
  if (fakes) pthread_create(&thread, NULL, make_up, NULL);

  uint8_t bytes[300];
  uint64_t start = now_ns(), sent = 0, ticks = rate * seconds;
  for (uint64_t k = 0; k < ticks; k++)
    for (int i = 0; i < vehicles; i++) {
      wait_until(start + (k + (double)i / vehicles) * 1e9 / rate);
      int beat = (k + i) % (rate < 1 ? 1 : (uint64_t)rate) == 0;
      uint32_t mode = i / links < watched ? now_ns() / 1000000 : 0;
      int n = beat ? heartbeat_in(bytes, seq[i]++, i / links + 1, 1, 2, 3, mode) : telemetry(bytes, seq[i]++, i / links + 1, i * 1000, k);
      if (send(fd[i], bytes, n, 0) == n && !beat) sent++;
    }

  done = 1;
  printf("{\"sent\": %lu, \"seconds\": %.2f}\n", sent, (now_ns() - start) / 1e9);
  return 0;
}
