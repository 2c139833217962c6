typedef struct { uint8_t X; int64_t T, start; uint8_t last; } Step;
typedef struct { uint8_t go; int32_t done; uint8_t clamp, drill, eject; Step st[5]; uint8_t ready; } Sequence;
static struct { Sequence s[20]; int16_t i; int32_t n, sum; int64_t result; } s;
static void sequence(Sequence *f, int64_t now) {
  uint8_t fire[5], rise;
  if (!f->ready) { f->ready = 1; f->st[0].X = 1; f->st[0].start = now; goto actions; }
  for (int i = 0; i < 5; i++) if (f->st[i].X && f->st[i].last) f->st[i].T = now - f->st[i].start;
  fire[0] = f->st[0].X && f->go;
  fire[1] = f->st[1].X && f->st[1].T >= 20000000;
  fire[2] = f->st[2].X && f->st[2].T >= 50000000;
  fire[3] = f->st[3].X && f->st[3].T >= 20000000;
  fire[4] = f->st[4].X && f->st[4].T >= 10000000;
  for (int i = 0; i < 5; i++) if (fire[i]) f->st[i].X = 0;
  for (int i = 0; i < 5; i++) if (fire[i]) { Step *t = &f->st[(i + 1) % 5]; t->X = 1; t->start = now; t->T = 0; }
actions:
  rise = f->st[4].X && !f->st[4].last;
  for (int i = 0; i < 5; i++) f->st[i].last = f->st[i].X;
  if (rise) f->done++;
  if (f->st[1].X) f->clamp = 1;
  if (f->st[4].X) f->clamp = 0;
  f->drill = f->st[2].X;
  f->eject = f->st[4].X;
}
void SCAN(int64_t now) {
  s.n++; s.sum = 0;
  for (s.i = 0; s.i <= 19; s.i++) {
    Sequence *f = &s.s[s.i];
    f->go = (s.n + s.i) % 5 == 0; sequence(f, now);
    s.sum += f->done; if (f->drill) s.sum++;
  }
  s.result = s.sum;
}
double RESULT(void) { return (double)s.result; }
