typedef struct { int32_t len; char c[80]; } S80;
typedef struct { int32_t len; char c[20]; } S20;
static struct { S80 line; S20 word; int16_t i; int32_t hits, n; int64_t result; } s;
static void cat(S80 *d, const char *p, int32_t n) { if (n > 80 - d->len) n = 80 - d->len; memcpy(d->c + d->len, p, n); d->len += n; }
static int32_t find(const char *a, int32_t n, const char *b, int32_t m) { for (int32_t i = 0; i + m <= n; i++) if (!memcmp(a + i, b, m)) return i + 1; return 0; }
static int32_t cmp(const char *a, int32_t n, const char *b, int32_t m) { int r = memcmp(a, b, n < m ? n : m); return r ? r : n - m; }
static int32_t lim(int32_t v, int32_t hi) { return v < 0 ? 0 : v > hi ? hi : v; }
void SCAN(int64_t now) {
  s.n++; s.line.len = 0;
  for (s.i = 1; s.i <= 8; s.i++) {
    memcpy(s.word.c, (s.n + s.i) % 2 == 0 ? "valve" : "motor", 5); s.word.len = 5;
    cat(&s.line, s.word.c, s.word.len); cat(&s.line, " ", 1);
    if (s.line.len > 60) { memmove(s.line.c, s.line.c + s.line.len - 20, 20); s.line.len = 20; }
  }
  if (find(s.line.c, s.line.len, "motor valve", 11) > 0) s.hits += 1;
  if (cmp(s.line.c, lim(5, s.line.len), "motor", 5) == 0) s.hits += 2;
  S80 t; int32_t a, b;
  t.len = 0; a = lim(6, s.line.len); b = lim(5, s.line.len - a); cat(&t, s.line.c, a); cat(&t, "pump", 4); cat(&t, s.line.c + a + b, s.line.len - a - b); s.line = t;
  t.len = 0; a = lim(1, s.line.len); b = lim(3, s.line.len - a); cat(&t, s.line.c, a); cat(&t, s.line.c + a + b, s.line.len - a - b); s.line = t;
  t.len = 0; a = lim(4, s.line.len); cat(&t, s.line.c, a); cat(&t, "--", 2); cat(&t, s.line.c + a, s.line.len - a); s.line = t;
  a = lim(5, s.line.len); b = lim(4, s.line.len - a);
  if (cmp(s.line.c + a, b, "pump", 4) < 0) s.hits += 4;
  s.result = s.hits + s.line.len;
}
double RESULT(void) { return (double)s.result; }
