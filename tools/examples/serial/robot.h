/* The robot's end of the serial line (docs/reference/serial.md), without allocation, for little-endian machines. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

uint16_t crc16(const void *data, size_t n) {
  const uint8_t *p = data;
  uint16_t crc = 0;
  while (n--) {
    crc ^= (uint16_t)(*p++ << 8);
    for (int i = 0; i < 8; i++) crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
  }
  return crc;
}

/* text, checksum and LF; out has room for 257 bytes. Returns the number of bytes to send. */
int seal(char *out, const char *text) { return sprintf(out, "%s*%04X\n", text, crc16(text, strlen(text))); }

/* 1 when a received line, without its LF, is intact; its checksum is then cut off. */
int unseal(char *line) {
  char *star = strrchr(line, '*');
  if (!star || strlen(star) != 5 || strtoul(star + 1, NULL, 16) != crc16(line, (size_t)(star - line))) return 0;
  *star = 0;
  return 1;
}

/* COBS and the zero; out has room for n + n / 254 + 2 bytes. Returns the number of bytes to send. */
size_t cobs(uint8_t *out, const void *data, size_t n) {
  const uint8_t *in = data;
  size_t code = 0, at = 1;
  for (size_t i = 0; i < n; i++) {
    if (in[i]) out[at++] = in[i];
    if (!in[i] || at - code == 255) {
      out[code] = (uint8_t)(at - code);
      code = at++;
    }
  }
  out[code] = (uint8_t)(at - code);
  out[at++] = 0;
  return at;
}

/* A binary pose: x, y, z in mm, quaternion w, x, y, z. out has room for 43 bytes. */
size_t pose_frame(uint8_t *out, uint16_t seq, uint64_t t_ns, const float pose[7]) {
  uint8_t raw[41] = {'P'};
  memcpy(raw + 1, &seq, 2);
  memcpy(raw + 3, &t_ns, 8);
  memcpy(raw + 11, pose, 28);
  uint16_t crc = crc16(raw, 39);
  memcpy(raw + 39, &crc, 2);
  return cobs(out, raw, 41);
}

/* A line in binary mode; line is the n bytes that seal wrote. out has room for 260 bytes. */
size_t line_frame(uint8_t *out, const char *line, size_t n) {
  char raw[257] = {'L'};
  memcpy(raw + 1, line, n - 1);
  return cobs(out, raw, n);
}
