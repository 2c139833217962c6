typedef struct { uint8_t x; int16_t n; uint8_t q; int16_t count; } Debounce;
typedef struct { uint8_t CLK, Q, M; } RTrig;
typedef struct { uint8_t open; int32_t moves; Debounce d; RTrig e; } Valve;
typedef struct { int32_t k, sum; Valve v[4]; int16_t i; } Station;
static struct { Station s[16]; int16_t i; int32_t k, total; int64_t result; } s;
static void debounce(Debounce *f) {
  if (f->x) { if (f->count < f->n) f->count++; } else if (f->count > 0) f->count--;
  if (f->count == f->n) f->q = 1; else if (f->count == 0) f->q = 0;
}
static void rtrig(RTrig *f) { f->Q = f->CLK && !f->M; f->M = f->CLK; }
static void valve(Valve *f) { f->d.x = f->open; f->d.n = 3; debounce(&f->d); f->e.CLK = f->d.q; rtrig(&f->e); if (f->e.Q) f->moves++; }
static void station(Station *f) {
  f->sum = 0;
  for (f->i = 0; f->i <= 3; f->i++) { f->v[f->i].open = (f->k + f->i) % 11 < 5; valve(&f->v[f->i]); f->sum += f->v[f->i].moves; }
}
void SCAN(int64_t now) {
  s.k++; s.total = 0;
  for (s.i = 0; s.i <= 15; s.i++) { s.s[s.i].k = s.k + s.i; station(&s.s[s.i]); s.total += s.s[s.i].sum; }
  s.result = s.total;
}
double RESULT(void) { return (double)s.result; }
