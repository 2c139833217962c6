use fam_soft_plc::*;
use std::time::Instant;
fn run(name: &str, text: &str) {
    let (p, d) = parse_project(&[SourceFile::new("t.st", text)]);
    assert!(d.is_empty(), "{}", d[0]);
    let t0 = Instant::now();
    let t = check(&p, CheckOptions::default()).unwrap_or_else(|d| panic!("{}", d[0]));
    let mc = compile(&t, &CompileSpec { entry: "P".into(), ..Default::default() }).unwrap();
    let t1 = Instant::now();
    let e = Engine::new(EngineOptions::default()).unwrap();
    let m = e.prepare(&mc).unwrap();
    let t2 = Instant::now();
    let mut i = Instance::new(&e, &m).unwrap();
    let t3 = Instant::now();
    let mut best = f64::MAX;
    for _ in 0..30 {
        let s = Instant::now();
        for k in 0..200 { i.scan(k, 1_000_000).unwrap(); }
        best = best.min(s.elapsed().as_nanos() as f64 / 200.0);
    }
    println!("{name:20} {best:10.1} ns/scan  check+compile {:?} prepare {:?} instance {:?} wasm {}", t1 - t0, t2 - t1, t3 - t2, mc.wasm.len());
}
fn main() {
    run("empty", "PROGRAM P VAR x : INT; END_VAR x := 1; END_PROGRAM");
    run("for sum 1000", "PROGRAM P VAR i : DINT; s : DINT; a : ARRAY[0..999] OF DINT; END_VAR s := 0; FOR i := 0 TO 999 DO s := s + a[i] * 3; END_FOR; END_PROGRAM");
    run("for lreal 1000", "PROGRAM P VAR i : INT; s : LREAL; a : ARRAY[0..999] OF LREAL; END_VAR s := 0.0; FOR i := 0 TO 999 DO s := s + a[i] * 3.0; a[i] := s; END_FOR; END_PROGRAM");
    run("matrix 30x30", "PROGRAM P VAR i,j,k : INT; s : REAL; a,b,c : ARRAY[0..29,0..29] OF REAL; END_VAR FOR i := 0 TO 29 DO FOR j := 0 TO 29 DO s := 0.0; FOR k := 0 TO 29 DO s := s + a[i,k] * b[k,j]; END_FOR; c[i,j] := s; END_FOR; END_FOR; END_PROGRAM");
    run("100 ton", "PROGRAM P VAR i : INT; t : ARRAY[0..99] OF TON; END_VAR FOR i := 0 TO 99 DO t[i](IN := TRUE, PT := T#1s); END_FOR; END_PROGRAM");
    run("crc 1k", "PROGRAM P VAR i, j : INT; crc : DWORD; d : ARRAY[0..1023] OF BYTE; END_VAR crc := 16#FFFFFFFF; FOR i := 0 TO 1023 DO crc := crc XOR BYTE_TO_DWORD(d[i]); FOR j := 0 TO 7 DO IF (crc AND 1) <> 0 THEN crc := SHR(crc, 1) XOR 16#EDB88320; ELSE crc := SHR(crc, 1); END_IF; END_FOR; END_FOR; END_PROGRAM");
    let mut big = String::from("PROGRAM P VAR a : ARRAY[0..99] OF INT; x, y : INT; b : BOOL; END_VAR ");
    for k in 0..10000 { big.push_str(&format!("IF a[{}] > x THEN a[{}] := y + {}; END_IF;\n", k % 100, (k * 7) % 100, k % 50)); }
    big.push_str("END_PROGRAM");
    run("big 10k", &big);
}
