/* MAVLink 2 frames for the load generators. */
#include <stdint.h>
#include <string.h>
#include <time.h>

static uint64_t now_ns(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (uint64_t)t.tv_sec * 1000000000u + t.tv_nsec;
}

static uint16_t crc_byte(uint16_t crc, uint8_t byte) {
  uint8_t t = byte ^ (crc & 0xff);
  t ^= t << 4;
  return (crc >> 8) ^ ((uint16_t)t << 8) ^ ((uint16_t)t << 3) ^ (t >> 4);
}

static int frame(uint8_t *out, uint8_t seq, uint8_t system, uint8_t component, uint8_t id, const uint8_t *payload, int n,
                 uint8_t extra) {
  uint8_t head[10] = {0xFD, n, 0, 0, seq, system, component, id, 0, 0};
  memcpy(out, head, 10);
  memcpy(out + 10, payload, n);
  uint16_t crc = 0xffff;
  for (int i = 1; i < 10 + n; i++) crc = crc_byte(crc, out[i]);
  crc = crc_byte(crc, extra);
  out[10 + n] = crc & 0xff;
  out[11 + n] = crc >> 8;
  return 12 + n;
}

static int heartbeat_in(uint8_t *out, uint8_t seq, uint8_t system, uint8_t component, uint8_t type, uint8_t autopilot,
                        uint32_t mode) {
  uint8_t payload[9] = {0, 0, 0, 0, type, autopilot, 0, 4, 3};
  memcpy(payload, &mode, 4);
  return frame(out, seq, system, component, 0, payload, 9, 50);
}

static int heartbeat(uint8_t *out, uint8_t seq, uint8_t system, uint8_t component, uint8_t type, uint8_t autopilot) {
  return heartbeat_in(out, seq, system, component, type, autopilot, 0);
}

/* The k-th frame of a vehicle's telemetry: ATTITUDE, GLOBAL_POSITION_INT, VFR_HUD and SYS_STATUS in turn. time_boot_ms is
 * CLOCK_MONOTONIC, so that whoever shows the state knows how old it is. */
static int telemetry(uint8_t *out, uint8_t seq, uint8_t system, int east, long k) {
  uint8_t p[31];
  uint32_t ms = now_ns() / 1000000;
  /* No zeros at the end, so that lengths are always the same. */
  memset(p, 0x3f, sizeof p);
  memcpy(p, &ms, 4);
  switch (k % 5) {
    case 0: {
      int32_t position[5] = {473977418, 85455938 + east, 488000, 10000, 0};
      memcpy(p + 4, position, 20);
      memset(p + 20, 1, 8);
      return frame(out, seq, system, 1, 33, p, 28, 104);
    }
    case 1:
      return frame(out, seq, system, 1, 74, p, 20, 20);
    case 2:
      p[30] = 90;
      return frame(out, seq, system, 1, 1, p, 31, 124);
    default: {
      float roll = (k % 100) / 1000.0f + 0.001f;
      memcpy(p + 4, &roll, 4);
      return frame(out, seq, system, 1, 30, p, 28, 39);
    }
  }
}
