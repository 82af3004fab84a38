/* A source of MAVLink frames and its receivers, for bench/router.exs: as cheap as they can be, outside of the router.
 *
 *     router_load SOURCE_PORT CLIENT_PORT CLIENT_STEP CLIENTS RATE SECONDS [SOURCES SOURCE_STEP AUTOPILOT]
 *
 * SOURCES sockets (systems 1, 2, ...) send ATTITUDE frames, one a datagram, to 127.0.0.1:(SOURCE_PORT + i *
 * SOURCE_STEP): RATE a second in all, evenly spaced; one source above 20,000 a second says every 200 us what is due, with one
 * system call that the kernel makes datagrams of (UDP_SEGMENT), because no more than that leaves a radio's or a switch's
 * buffer evenly spaced, and the sender is not what is measured. CLIENTS sockets say a ground station's heartbeat to 127.0.0.1:(CLIENT_PORT + i * CLIENT_STEP) and count
 * what comes; a frame carries the time at which it was sent. Systems whose frames are to be told apart are known by it.
 *
 * All sockets have ports of their own that are the same in every run. Routers remember a peer of UDP for a minute and more:
 * peers of other ports in each run would be more and more clients, and one source that is heard by several ways.
 *
 * Prints one line: sent, received by the worst and by all clients, and of the added latency p50, p99 and max in
 * microseconds (from before the send to after the receive, of all clients).
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <netinet/udp.h>
#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "frames.h"

#define MAX_CLIENTS 64
#define MAX_SOURCES 128
#define BUCKETS 200000 /* of one microsecond */
#define BATCH 64
#define OWN_PORTS 400 /* from the port that is sent to, to the one that it is sent from */

static int clients, sources, autopilot, source_fd[MAX_SOURCES], client_fd[MAX_CLIENTS];
static struct sockaddr_in source_to[MAX_SOURCES], client_to[MAX_CLIENTS];
static uint64_t sent, got[MAX_CLIENTS], max_us, late;
static uint32_t histogram[BUCKETS];
static volatile int done;
static double rate;
static int seconds;

/* A vehicle's clock in the first four bytes (milliseconds) and when it is sent in the next: the microseconds' low 23 bits as
 * the fraction of a number from 1 to 2, which is an angle like any other. The last byte is no zero, so that all frames are
 * of one length. */
#define STAMP 0x7fffff
static int attitude(uint8_t *out, uint8_t seq, uint8_t system, uint64_t us) {
  uint8_t payload[28];
  uint32_t ms = us / 1000, roll = 0x3f800000 | (us & STAMP);
  memset(payload, 0x3f, sizeof payload);
  memcpy(payload, &ms, 4);
  memcpy(payload + 4, &roll, 4);
  return frame(out, seq, system, 1, 30, payload, 28, 39);
}

/* At the wanted port, so that a further run is the same peers and not more of them, or at any when that is taken. */
static int udp(int port) {
  int fd = socket(AF_INET, SOCK_DGRAM, 0), size = 8 << 20;
  struct sockaddr_in any = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK), .sin_port = htons(port)};
  setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
  if (fd < 0) exit(2);
  if (bind(fd, (struct sockaddr *)&any, sizeof any)) {
    any.sin_port = 0;
    if (bind(fd, (struct sockaddr *)&any, sizeof any)) exit(2);
  }
  return fd;
}

static void say(int i) {
  uint8_t bytes[300];
  int n = heartbeat(bytes, 0, 200 - i, 190, 6, 8);
  sendto(client_fd[i], bytes, n, 0, (struct sockaddr *)&client_to[i], sizeof client_to[i]);
}

static void vehicles(void) {
  uint8_t bytes[300];
  for (int i = 0; i < sources; i++) {
    int n = heartbeat(bytes, 0, i + 1, 1, 2, autopilot);
    sendto(source_fd[i], bytes, n, 0, (struct sockaddr *)&source_to[i], sizeof source_to[i]);
  }
}

static void take(int client, const uint8_t *bytes, int size, uint32_t us) {
  while (size >= 12 && bytes[0] == 0xFD) {
    int n = 12 + bytes[1] + ((bytes[2] & 1) ? 13 : 0);
    if (n > size) break;
    if (bytes[7] == 30 && bytes[1] == 28) {
      uint32_t at;
      memcpy(&at, bytes + 14, 4);
      uint32_t took = (us - at) & STAMP;
      got[client]++;
      if (took > max_us) max_us = took;
      if (took < BUCKETS) __atomic_fetch_add(&histogram[took], 1, __ATOMIC_RELAXED);
      else late++;
    }
    bytes += n;
    size -= n;
  }
}

static void *receive(void *unused) {
  (void)unused;
  static uint8_t space[BATCH][2048];
  struct mmsghdr messages[BATCH];
  struct iovec vectors[BATCH];
  int poller = epoll_create1(0);
  for (int i = 0; i < clients; i++) {
    struct epoll_event event = {.events = EPOLLIN, .data.u32 = i};
    epoll_ctl(poller, EPOLL_CTL_ADD, client_fd[i], &event);
  }
  memset(messages, 0, sizeof messages);
  for (int i = 0; i < BATCH; i++) {
    vectors[i] = (struct iovec){space[i], sizeof space[i]};
    messages[i].msg_hdr.msg_iov = &vectors[i];
    messages[i].msg_hdr.msg_iovlen = 1;
  }
  uint64_t next = 0;
  while (!done) {
    struct epoll_event events[MAX_CLIENTS];
    int n = epoll_wait(poller, events, MAX_CLIENTS, 50);
    uint64_t at = now_ns();
    for (int e = 0; e < n; e++) {
      int client = events[e].data.u32, k;
      while ((k = recvmmsg(client_fd[client], messages, BATCH, MSG_DONTWAIT, NULL)) > 0) {
        uint32_t us = now_ns() / 1000;
        for (int i = 0; i < k; i++) take(client, space[i], messages[i].msg_len, us);
        if (k < BATCH) break;
      }
    }
    if (at > next) {
      for (int i = 0; i < clients; i++) say(i);
      next = at + 1000000000u;
    }
  }
  return NULL;
}

#define BURST_NS 200000u
#define BURST_RATE 20000
#define MOST 64 /* datagrams that the kernel makes of one call */
#define ATTITUDE_BYTES 40

static void send_bursts(void) {
  uint8_t bytes[MOST * ATTITUDE_BYTES], seq = 0;
  int size = ATTITUDE_BYTES;
  uint64_t start = now_ns(), end = start + (uint64_t)seconds * 1000000000u, next_beat = start + 1000000000u, step = 0;
  setsockopt(source_fd[0], SOL_UDP, UDP_SEGMENT, &size, sizeof size);
  for (uint64_t at = start; at < end; at = start + ++step * BURST_NS) {
    struct timespec t = {.tv_sec = at / 1000000000u, .tv_nsec = at % 1000000000u};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
    if (at >= next_beat) {
      vehicles();
      next_beat += 1000000000u;
    }
    uint64_t due = (step + 1) * (BURST_NS * rate / 1e9);
    while (sent < due) {
      int n = 0;
      uint64_t us = now_ns() / 1000;
      while (n < MOST && sent + n < due) attitude(bytes + n++ * ATTITUDE_BYTES, seq++, 1, us);
      if (sendto(source_fd[0], bytes, n * size, 0, (struct sockaddr *)&source_to[0], sizeof source_to[0]) < 0) continue;
      sent += n;
    }
  }
}

static void send_all(void) {
  uint8_t bytes[300], seq[MAX_SOURCES] = {0};
  uint64_t start = now_ns(), end = start + (uint64_t)seconds * 1000000000u, next_beat = 0, i = 0;
  prctl(PR_SET_TIMERSLACK, 1);
  for (;;) {
    uint64_t now = now_ns();
    if (now >= end) break;
    if (now >= next_beat) {
      vehicles();
      next_beat = now + 1000000000u;
    }
    uint64_t due = start + (uint64_t)(i * 1e9 / rate);
    if (due > now) {
      struct timespec t = {.tv_sec = due / 1000000000u, .tv_nsec = due % 1000000000u};
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
      continue;
    }
    int s = i % sources;
    int n = attitude(bytes, seq[s]++, s + 1, now_ns() / 1000);
    if (sendto(source_fd[s], bytes, n, 0, (struct sockaddr *)&source_to[s], sizeof source_to[s]) == n) sent++;
    i++;
  }
}

static uint64_t percentile(double share) {
  uint64_t all = late, sum = 0;
  for (int i = 0; i < BUCKETS; i++) all += histogram[i];
  for (int i = 0; i < BUCKETS; i++) {
    sum += histogram[i];
    if (sum >= share * all && sum) return i;
  }
  return BUCKETS;
}

int main(int argc, char **argv) {
  if (argc < 7) return 64;
  int source_port = atoi(argv[1]), client_port = atoi(argv[2]), step = atoi(argv[3]);
  clients = atoi(argv[4]);
  rate = atof(argv[5]);
  seconds = atoi(argv[6]);
  sources = argc > 7 ? atoi(argv[7]) : 1;
  int source_step = argc > 8 ? atoi(argv[8]) : 0;
  autopilot = argc > 9 ? atoi(argv[9]) : 3;
  if (clients < 1 || clients > MAX_CLIENTS || sources < 1 || sources > MAX_SOURCES || rate <= 0) return 64;
  struct sockaddr_in to = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  for (int i = 0; i < sources; i++) {
    source_fd[i] = udp(source_port + OWN_PORTS + i);
    source_to[i] = to;
    source_to[i].sin_port = htons(source_port + i * source_step);
  }
  for (int i = 0; i < clients; i++) {
    client_fd[i] = udp(client_port + OWN_PORTS + i);
    client_to[i] = to;
    client_to[i].sin_port = htons(client_port + i * step);
    say(i);
  }
  vehicles();
  pthread_t receiver;
  pthread_create(&receiver, NULL, receive, NULL);
  usleep(700000);
  vehicles();
  usleep(300000);
  if (sources == 1 && rate > BURST_RATE) {
    prctl(PR_SET_TIMERSLACK, 1);
    send_bursts();
  } else {
    send_all();
  }
  usleep(500000);
  done = 1;
  pthread_join(receiver, NULL);
  uint64_t worst = UINT64_MAX, all = 0;
  for (int i = 0; i < clients; i++) {
    if (got[i] < worst) worst = got[i];
    all += got[i];
  }
  printf("{\"sent\":%lu,\"worst\":%lu,\"received\":%lu,\"p50\":%lu,\"p99\":%lu,\"max\":%lu}\n", sent, worst, all,
         percentile(0.5), percentile(0.99), max_us);
  return 0;
}
