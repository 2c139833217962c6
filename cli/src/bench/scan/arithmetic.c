static struct { int32_t a, b, c; uint32_t x; int16_t i; int64_t result; } s = { 12345, 6789, 0, 1, 0, 0 };
void SCAN(int64_t now) {
  for (s.i = 1; s.i <= 50; s.i++) {
    int32_t t = (int32_t)((uint32_t)s.a * 31u + (uint32_t)(s.b / 7) - (uint32_t)(s.a % 1000) * 3u);
    s.c = (int32_t)((uint32_t)t + (uint32_t)(s.c / 3) + (uint32_t)s.i);
    s.x = s.x * 1664525u + 1013904223u;
    if (s.c > 1000000) s.c = (int32_t)((uint32_t)s.c - 2000000u); else if (s.c < -1000000) s.c = (int32_t)((uint32_t)s.c + 2000000u);
    s.a = (int32_t)((uint32_t)s.b + (uint32_t)((int32_t)(s.x / 65536) % 512));
    s.b = (int32_t)((uint32_t)s.c + (uint32_t)(s.i * 5));
  }
  s.result = (int64_t)(int32_t)((uint32_t)s.c + (uint32_t)s.a - (uint32_t)s.b);
}
double RESULT(void) { return (double)s.result; }
