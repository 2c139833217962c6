typedef struct { uint8_t IN; int64_t PT; uint8_t Q; int64_t ET; uint8_t running; int64_t start; } TON;
typedef struct { uint8_t CU, R; int16_t PV; uint8_t Q; int16_t CV; uint8_t last; } CTU;
static struct { TON t[40]; CTU c[40]; int16_t i; int32_t phase; int64_t result; int32_t sum; } s;
static void ton(TON *f, int64_t now) {
  if (!f->IN) { f->running = 0; f->Q = 0; f->ET = 0; }
  else {
    if (!f->running) { f->running = 1; f->start = now; }
    if (!f->Q) { f->ET = now - f->start; if (f->ET >= f->PT) { f->ET = f->PT; f->Q = 1; } }
  }
}
static void ctu(CTU *f) {
  if (f->R) f->CV = 0; else if (f->CU && !f->last && f->CV < 32767) f->CV++;
  f->last = f->CU; f->Q = f->CV >= f->PV;
}
void SCAN(int64_t now) {
  s.phase++; s.sum = 0;
  for (s.i = 0; s.i <= 39; s.i++) {
    TON *t = &s.t[s.i]; CTU *c = &s.c[s.i];
    t->IN = (s.phase + s.i) % 16 > 3; t->PT = 50000000; ton(t, now);
    c->CU = t->Q; c->R = 0; c->PV = 100; ctu(c);
    if (c->CV > 1000) { c->CU = 0; c->R = 1; c->PV = 100; ctu(c); }
    s.sum += c->CV;
  }
  s.result = s.sum;
}
double RESULT(void) { return (double)s.result; }
