//! What programs compute: statements, operators, standard functions and blocks, as the standard says.

use crate::common::{CYCLE_NS, Machine, run};
use fam_soft_plc::Value;

/// (declarations, statements, variable, value after one scan)
#[rustfmt::skip]
const CASES: &[(&str, &str, &str, &str)] = &[
    // Precedence and associativity.
    ("r : INT;", "r := 2 + 3 * 4;", "r", "14"),
    ("r : INT;", "r := (2 + 3) * 4;", "r", "20"),
    ("r : INT; a : INT := 7;", "r := -a MOD 4;", "r", "-3"),
    ("r : INT; a : INT := 20;", "r := a / 3 / 2;", "r", "3"),
    ("r : LREAL; a : LREAL := 2.0;", "r := a ** 3 ** 2;", "r", "64.0"),
    ("r : LREAL; a : LREAL := 2.0;", "r := -a ** 2;", "r", "4.0"),
    ("r : BOOL; a : BOOL := TRUE; b : BOOL;", "r := a OR b AND b;", "r", "TRUE"),
    ("r : BOOL; a : BOOL := TRUE; b : BOOL := TRUE;", "r := a XOR b OR a;", "r", "TRUE"),
    ("r : BOOL; a : INT := 3;", "r := NOT (a > 2) OR a = 3 & a < 4;", "r", "TRUE"),
    ("r : BOOL; a : INT := 1;", "r := a < 2 = TRUE;", "r", "TRUE"),
    ("r : BOOL; x : BOOL;", "r := NOT x;", "r", "TRUE"),
    ("r : BYTE; x : BYTE := 2#0101_0000;", "r := NOT x;", "r", "175"),
    // Wrapping and division.
    ("r : SINT := 127;", "r := r + 1;", "r", "-128"),
    ("r : USINT;", "r := r - 1;", "r", "255"),
    ("r : INT := 32767;", "r := r + INT#1;", "r", "-32768"),
    ("r : UINT := 65535;", "r := r * r;", "r", "1"),
    ("r : DINT := 2147483647;", "r := r + 1;", "r", "-2147483648"),
    ("r : UDINT;", "r := r - 1;", "r", "4294967295"),
    ("r : LINT := 9223372036854775807;", "r := r + 1;", "r", "-9223372036854775808"),
    ("r : ULINT;", "r := r - 1;", "r", "18446744073709551615"),
    ("r : DINT := -2147483648; d : DINT := -1;", "r := r / d;", "r", "-2147483648"),
    ("r : LINT := -9223372036854775808; d : LINT := -1;", "r := r / d;", "r", "-9223372036854775808"),
    ("r : SINT := -128; d : SINT := -1;", "r := r / d;", "r", "-128"),
    ("r : DINT := -2147483648; d : DINT := -1;", "r := r MOD d;", "r", "0"),
    ("r : INT := -7;", "r := r / 2;", "r", "-3"),
    ("r : INT := -7;", "r := r MOD 2;", "r", "-1"),
    ("r : UDINT := 4294967295;", "r := r / 2;", "r", "2147483647"),
    ("r : ULINT := 18446744073709551615;", "r := r MOD 10;", "r", "5"),
    ("r : INT := -32768;", "r := -r;", "r", "-32768"),
    ("r : INT := -32768;", "r := ABS(r);", "r", "-32768"),
    // Implicit widening; the operation is done in the common type of its operands.
    ("r : DINT; a : INT := 20000;", "r := a + a;", "r", "-25536"),
    ("r : DINT; a : INT := 20000; b : DINT := 20000;", "r := a + b;", "r", "40000"),
    ("r : LINT; a : UDINT := 4000000000; b : INT := -1;", "r := a + b;", "r", "3999999999"),
    ("r : DINT; a : INT := 300;", "r := a + 100000;", "r", "100300"),
    ("r : LREAL; a : DINT := 3;", "r := a / 2.0;", "r", "1.5"),
    ("r : REAL; a : INT := 3;", "r := a / 2;", "r", "1.0"),
    ("r : REAL; a : INT := 3;", "r := a * 0.5;", "r", "1.5"),
    ("r : BOOL; a : USINT := 200; b : SINT := -56;", "r := a = b;", "r", "FALSE"),
    ("r : WORD; a : BYTE := 16#F0;", "r := a OR 16#0F00;", "r", "4080"),
    ("r : LREAL; a : REAL := 0.1;", "r := a;", "r", "0.10000000149011612"),
    // Literals.
    ("r : DINT;", "r := 16#7FFF_FFFF;", "r", "2147483647"),
    ("r : BYTE;", "r := 2#1010_0101;", "r", "165"),
    ("r : INT;", "r := 8#17 + INT#16#10 + SINT#-5;", "r", "26"),
    ("r : REAL;", "r := REAL#1.5E1;", "r", "15.0"),
    ("r : BOOL;", "r := BOOL#1;", "r", "TRUE"),
    ("r : LINT;", "r := -9223372036854775808;", "r", "-9223372036854775808"),
    ("r : TIME;", "r := T#1d2h3m4s5ms6us7ns;", "r", "T#1d2h3m4s5ms6us7ns"),
    ("r : TIME;", "r := TIME#-1.5s;", "r", "T#-1s500ms"),
    ("r : TIME;", "r := t#90m;", "r", "T#1h30m"),
    // TIME.
    ("r : TIME; a : TIME := T#1s;", "r := a * 3 + T#500ms;", "r", "T#3s500ms"),
    ("r : TIME; a : TIME := T#1s; n : INT := 4;", "r := a / n;", "r", "T#250ms"),
    ("r : TIME; a : TIME := T#1s;", "r := a * 0.25;", "r", "T#250ms"),
    ("r : TIME; a : TIME := T#1s;", "r := 2 * a - T#5s;", "r", "T#-3s"),
    ("r : BOOL; a : TIME := T#1s;", "r := a > T#-1s AND a <> T#0s;", "r", "TRUE"),
    ("r : LINT; a : TIME := T#1ms;", "r := TIME_TO_LINT(a);", "r", "1000000"),
    ("r : TIME; a : LINT := 1500;", "r := LINT_TO_TIME(a);", "r", "T#1us500ns"),
    // Conversions.
    ("r : INT; a : REAL := 2.5;", "r := REAL_TO_INT(a);", "r", "2"),
    ("r : INT; a : REAL := 3.5;", "r := REAL_TO_INT(a);", "r", "4"),
    ("r : INT; a : LREAL := -2.5;", "r := LREAL_TO_INT(a);", "r", "-2"),
    ("r : INT; a : REAL := -2.9;", "r := TRUNC(a);", "r", "-2"),
    ("r : INT; a : LREAL := 2.9;", "r := LREAL_TRUNC_INT(a);", "r", "2"),
    ("r : DWORD; a : REAL := 1.0;", "r := REAL_TO_DWORD(a);", "r", "1065353216"),
    ("r : REAL; a : DWORD := 16#40490FDB;", "r := DWORD_TO_REAL(a);", "r", "3.1415927"),
    ("r : LWORD; a : LREAL := -2.0;", "r := LREAL_TO_LWORD(a);", "r", "13835058055282163712"),
    ("r : LREAL; a : LWORD := 16#4000000000000000;", "r := LWORD_TO_LREAL(a);", "r", "2.0"),
    ("r : SINT; a : INT := 300;", "r := INT_TO_SINT(a);", "r", "44"),
    ("r : INT; a : WORD := 16#FFFE;", "r := WORD_TO_INT(a);", "r", "-2"),
    ("r : UINT; a : INT := -1;", "r := INT_TO_UINT(a);", "r", "65535"),
    ("r : DWORD; a : INT := -1;", "r := INT_TO_DWORD(a);", "r", "4294967295"),
    ("r : BOOL; a : INT := 2;", "r := INT_TO_BOOL(a);", "r", "TRUE"),
    ("r : BOOL; a : WORD := 2;", "r := WORD_TO_BOOL(a);", "r", "FALSE"),
    ("r : INT; a : BOOL := TRUE;", "r := BOOL_TO_INT(a);", "r", "1"),
    ("r : REAL; a : UDINT := 4294967295;", "r := UDINT_TO_REAL(a);", "r", "4294967300.0"),
    ("r : LREAL; a : ULINT := 18446744073709551615;", "r := TO_LREAL(a);", "r", "1.8446744073709552e19"),
    ("r : DINT; a : LREAL := 1.0E9;", "r := TO_DINT(a);", "r", "1000000000"),
    ("r : ULINT; a : LREAL := 1.0E19;", "r := LREAL_TO_ULINT(a);", "r", "10000000000000000000"),
    // Standard functions.
    ("r : REAL; a : REAL := 2.25;", "r := SQRT(a);", "r", "1.5"),
    ("r : LREAL; a : LREAL := 0.0;", "r := EXP(a);", "r", "1.0"),
    ("r : LREAL; a : LREAL := 100.0;", "r := LOG(a) + LN(a / 100.0);", "r", "2.0"),
    ("r : LREAL; a : LREAL := 0.0;", "r := SIN(a) + COS(a) + TAN(a) + ASIN(a) + ATAN(a);", "r", "1.0"),
    ("r : LREAL; a : LREAL := 1.0;", "r := ATAN2(a, -a) / ACOS(-a) * 4.0;", "r", "3.0"),
    ("r : LREAL; a : INT := 16;", "r := SQRT(a);", "r", "4.0"),
    ("r : LREAL; a : LREAL := 2.0;", "r := EXPT(a, 10);", "r", "1024.0"),
    ("r : INT; a : INT := -5;", "r := LIMIT(MN := 0, IN := a, MX := 10);", "r", "0"),
    ("r : INT; a : INT := 50;", "r := LIMIT(0, a, 10);", "r", "10"),
    ("r : DINT; a : INT := 5; b : DINT := 70000;", "r := MAX(a, b, 3);", "r", "70000"),
    ("r : REAL; a : REAL := 5.0;", "r := MIN(a, 2, 3.5);", "r", "2.0"),
    ("r : TIME; a : TIME := T#5s;", "r := MIN(a, T#3s);", "r", "T#3s"),
    ("r : INT; g : BOOL := TRUE;", "r := SEL(g, 1, 2);", "r", "2"),
    ("r : INT; g : BOOL;", "r := SEL(G := g, IN0 := 1, IN1 := 2);", "r", "1"),
    ("r : INT; k : INT := 2;", "r := MUX(k, 10, 20, 30, 40);", "r", "30"),
    ("r : INT; k : USINT := 0;", "r := MUX(K := k, IN0 := 10, IN1 := 20);", "r", "10"),
    ("r : BYTE; a : BYTE := 16#81;", "r := SHL(a, 1);", "r", "2"),
    ("r : BYTE; a : BYTE := 16#81; n : INT := 7;", "r := SHR(a, n);", "r", "1"),
    ("r : DWORD; a : DWORD := 16#FFFFFFFF; n : INT := 32;", "r := SHL(a, n);", "r", "0"),
    ("r : WORD; a : WORD := 1; n : INT := -1;", "r := SHR(a, n);", "r", "0"),
    ("r : BYTE; a : BYTE := 16#81;", "r := ROL(a, 1);", "r", "3"),
    ("r : BYTE; a : BYTE := 16#81; n : INT := 9;", "r := ROR(IN := a, N := n);", "r", "192"),
    ("r : WORD; a : WORD := 16#8001;", "r := ROR(a, 4);", "r", "6144"),
    ("r : DWORD; a : DWORD := 16#80000001;", "r := ROL(a, 33);", "r", "3"),
    ("r : LWORD; a : LWORD := 1;", "r := ROR(a, 1);", "r", "9223372036854775808"),
    ("r : LWORD; a : LWORD := 1; n : INT := 63;", "r := SHL(a, n);", "r", "9223372036854775808"),
    ("r : BOOL; a : REAL := 1.0; z : REAL;", "r := IS_VALID(a) AND NOT IS_VALID(a / z);", "r", "TRUE"),
    ("r : INT; a : INT := 3;", "r := ADD(a, 4, 5) - SUB(a, 1) + MUL(a, 2) + DIV(a, 2) + MOD(a, 2);", "r", "18"),
    ("r : BOOL; a : INT := 3;", "r := AND(GT(5, a, 1), NE(a, 2), LE(a, 3), EQ(a, 3));", "r", "TRUE"),
    ("r : WORD; a : WORD := 16#FF;", "r := XOR(a, 16#0F, 16#100);", "r", "496"),
    ("r : INT; a : INT := 3;", "r := MOVE(a);", "r", "3"),
    // IF, CASE.
    ("r : INT; a : INT := 5;", "IF a > 9 THEN r := 1; ELSIF a > 3 THEN r := 2; ELSIF a > 1 THEN r := 3; ELSE r := 4; END_IF", "r", "2"),
    ("r : INT; a : INT;", "IF a > 9 THEN r := 1; ELSIF a > 3 THEN r := 2; ELSE r := 4; END_IF", "r", "4"),
    ("r : INT; a : INT := 5;", "CASE a OF 1: r := 1; 2, 3: r := 2; 4..6, 9: r := 3; ELSE r := 4; END_CASE", "r", "3"),
    ("r : INT; a : INT := 9;", "CASE a OF 1: r := 1; 2, 3: r := 2; 4..6, 9: r := 3; ELSE r := 4; END_CASE", "r", "3"),
    ("r : INT; a : INT := 7;", "CASE a OF 1: r := 1; 2, 3: r := 2; 4..6, 9: r := 3; ELSE r := 4; END_CASE", "r", "4"),
    ("r : INT := 9; a : INT := 77;", "CASE a OF 1: r := 1; 2: r := 2; END_CASE", "r", "9"),
    ("r : INT; a : INT := -100;", "CASE a OF -100..-50: r := 1; 30000: r := 2; END_CASE", "r", "1"),
    ("r : INT; a : DWORD := 16#FFFFFFFF;", "CASE a OF 0: r := 1; 16#FFFFFFFF: r := 2; 16#FFFFFFFE: r := 3; 16#FFFFFFFD: r := 4; END_CASE", "r", "2"),
    ("r : INT; a : LINT := 5000000000;", "CASE a OF 5000000000: r := 1; ELSE r := 2; END_CASE", "r", "1"),
    ("r : INT; a : ULINT := 18446744073709551615;", "CASE a OF 9223372036854775808..18446744073709551615: r := 1; ELSE r := 2; END_CASE", "r", "1"),
    // Loops.
    ("r : INT; i : INT;", "FOR i := 1 TO 10 DO r := r + i; END_FOR", "r", "55"),
    ("r : INT; i : INT;", "FOR i := 1 TO 10 DO END_FOR; r := i;", "r", "11"),
    ("r : DINT; i : INT;", "FOR i := 10 TO 1 BY -3 DO r := r * 100 + i; END_FOR", "r", "10070401"),
    ("r : INT; i : INT;", "FOR i := 5 TO 1 DO r := r + 1; END_FOR", "r", "0"),
    ("r : INT; i : USINT;", "FOR i := 250 TO 255 DO r := r + 1; END_FOR", "r", "6"),
    ("r : INT; i : SINT; n : SINT := 127;", "FOR i := 120 TO n DO r := r + 1; END_FOR", "r", "8"),
    ("r : INT; i : USINT; n : USINT;", "FOR i := 3 TO n BY 1 DO r := r + 1; END_FOR", "r", "0"),
    ("r : INT; i : DINT;", "FOR i := 2147483640 TO 2147483647 BY 3 DO r := r + 1; END_FOR", "r", "3"),
    ("r : INT; i : LINT; n : LINT := -9223372036854775808;", "FOR i := -9223372036854775800 TO n BY -5 DO r := r + 1; END_FOR", "r", "2"),
    ("r : INT; i : INT; s : INT := -2;", "FOR i := 5 TO 0 BY s DO r := r + 1; END_FOR", "r", "3"),
    ("r : INT; i : INT; s : INT := 2;", "FOR i := 0 TO 5 BY s DO r := r + 1; END_FOR", "r", "3"),
    ("r : INT; i : INT; n : INT := 3;", "FOR i := 1 TO n DO n := 100; r := r + 1; END_FOR", "r", "3"),
    ("r : INT; i : INT;", "FOR i := 1 TO 10 DO IF i = 3 THEN CONTINUE; END_IF; IF i > 5 THEN EXIT; END_IF; r := r + i; END_FOR", "r", "12"),
    ("r : INT;", "WHILE r < 7 DO r := r + 2; END_WHILE", "r", "8"),
    ("r : INT; i : INT;", "WHILE TRUE DO i := i + 1; IF i MOD 2 = 0 THEN CONTINUE; END_IF; r := r + i; IF i > 8 THEN EXIT; END_IF; END_WHILE", "r", "25"),
    ("r : INT := 100;", "REPEAT r := r + 1; UNTIL TRUE END_REPEAT", "r", "101"),
    ("r : INT;", "REPEAT r := r + 1; IF r < 5 THEN CONTINUE; END_IF; UNTIL r >= 5 END_REPEAT", "r", "5"),
    ("r, i, j : INT;", "FOR i := 1 TO 3 DO FOR j := 1 TO 3 DO IF j = 2 THEN EXIT; END_IF; r := r + 1; END_FOR; END_FOR", "r", "3"),
    ("r : INT;", "r := 1; RETURN; r := 2;", "r", "1"),
    // Arrays, structures, bits.
    ("a : ARRAY[-1..1, 2..4] OF INT; i : INT := 1; r : INT;", "a[i, 4] := 7; a[i - 2, 2] := 5; r := a[1, i + 3] * 10 + a[-1, 2];", "r", "75"),
    ("a : ARRAY[0..2] OF ARRAY[0..3] OF DINT; i : INT := 2; r : DINT;", "a[i][i + 1] := 9; r := a[2][3];", "r", "9"),
    ("a, b : ARRAY[0..9] OF INT := [10(4)]; r : INT;", "a[3] := 1; b := a; a[3] := 2; r := b[3] * 10 + b[9];", "r", "14"),
    ("a : ARRAY[1..6] OF INT := [1, 2(2, 3), 9]; r : INT;", "r := a[1] * 10000 + a[2] * 1000 + a[3] * 100 + a[4] * 10 + a[5] + a[6];", "r", "12332"),
    ("a : ARRAY[0..3] OF SINT := [4(-1)]; i : INT := 2; r : SINT;", "a[i] := a[i] - 1; r := a[2] + a[3];", "r", "-3"),
    ("a : ARRAY[0..3] OF BOOL; i : INT := 2; r : BOOL;", "a[i] := TRUE; r := a[2] AND NOT a[1] AND NOT a[3];", "r", "TRUE"),
    ("r : WORD;", "r.3 := TRUE; r.15 := TRUE; r.0 := r.3;", "r", "32777"),
    ("r : BOOL; w : LWORD := 16#8000000000000000;", "r := w.63 AND NOT w.62;", "r", "TRUE"),
    ("r : INT;", "r.15 := TRUE;", "r", "-32768"),
    ("r : LINT;", "r.40 := TRUE; r.40 := FALSE; r.33 := TRUE;", "r", "8589934592"),
    ("a : ARRAY[0..1] OF BYTE; r : BYTE; i : INT := 1;", "a[i].7 := TRUE; a[i].1 := TRUE; r := a[1];", "r", "130"),
    ("r : INT(0..10);", "r := 7;", "r", "7"),
];

#[test]
fn statements_and_expressions_compute_what_the_standard_says() {
    let mut wrong = Vec::new();
    for (vars, body, name, expected) in CASES {
        let found = run(vars, body, &[name]).remove(0);
        if found != *expected {
            wrong.push(format!(
                "{vars}\n  {body}\n  {name} = {found}, expected {expected}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn comments_of_all_kinds_nest_and_are_passed_over() {
    let body = "(* a (* nested *) b *) r := 1; /* c /* d */ e */ r := r + 1; // r := 9;\n{pragma} r := r + 1;";
    assert_eq!(run("r : INT;", body, &["r"]), ["3"]);
}

#[test]
fn names_and_keywords_do_not_care_about_case() {
    let text = "program p var Count : int; end_var COUNT := count + 5; end_program";
    let mut m = Machine::new(text);
    m.scan();
    assert_eq!(m.text("cOUNT"), "5");
}

#[test]
fn enumerations_convert_and_select() {
    let text = "
TYPE
  Mode : (Off, Manual := 10, Auto);
  Wide : DINT (Low := -5, High := 100000);
  Level : (Low, High);
  Other : Mode := Auto;
END_TYPE
PROGRAM P
VAR m : Mode := Manual; o : Other; n, k : INT; w : Wide := High; d : DINT; l : Level; same : BOOL; END_VAR
n := Mode_TO_INT(m);
d := WIDE_TO_DINT(w);
m := INT_TO_Mode(11);
l := High;
same := l = Level#High AND m = o AND Auto = m;
w := Wide#Low;
CASE m OF
  Off, Manual: k := 1;
  Mode#Auto: k := 2;
END_CASE;
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    let names = ["n", "d", "m", "l", "same", "w", "k"];
    let values: Vec<String> = names.iter().map(|n| m.text(n)).collect();
    assert_eq!(values, ["10", "100000", "11", "1", "TRUE", "-5", "2"]);
}

#[test]
fn structures_nest_and_are_copied_whole() {
    let text = "
TYPE
  Inner : STRUCT a : BOOL; b : LREAL := 2.5; c : ARRAY[1..3] OF INT := [7, 8, 9]; END_STRUCT;
  Outer : STRUCT i : Inner := (a := TRUE, c := [1, 2]); list : ARRAY[0..1] OF Inner; n : SINT := -3; END_STRUCT;
END_TYPE
FUNCTION Swap : Outer
VAR_INPUT x : Outer; END_VAR
VAR keep : Inner; END_VAR
keep := x.list[0];
x.list[0] := x.list[1];
x.list[1] := keep;
Swap := x;
END_FUNCTION
PROGRAM P
VAR o, q : Outer; r : LREAL; s : INT; k : INT := 1; END_VAR
o.list[k].b := 10.0;
o.list[0].c[k + 1] := 80;
q := Swap(Swap(Swap(o)));
r := q.list[0].b + o.list[1].b;
s := q.list[1].c[2] + q.i.c[1] * 1000 + q.i.c[3] * 100;
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    assert_eq!(m.text("r"), "20.0");
    assert_eq!(m.text("s"), "1980");
    assert_eq!(m.text("q.i.a"), "TRUE");
    assert_eq!(m.text("q.n"), "-3");
    assert_eq!(m.text("o.list[1].c[2]"), "8");
}

#[test]
fn functions_take_arguments_in_every_form() {
    let text = "
VAR_GLOBAL calls : INT; END_VAR
FUNCTION Div2 : INT
VAR_INPUT a : INT; b : INT := 2; END_VAR
VAR_OUTPUT rest : INT; exact : BOOL; END_VAR
VAR_IN_OUT total : DINT; flag : BOOL; END_VAR
VAR local : INT := 3; END_VAR
VAR_EXTERNAL calls : INT; END_VAR
calls := calls + local - 2;
local := 99;
Div2 := a / b;
rest := a MOD b;
exact := rest = 0;
total := total + a;
flag := NOT flag;
END_FUNCTION
FUNCTION Note
VAR_INPUT x : INT; END_VAR
VAR_EXTERNAL calls : INT; END_VAR
calls := calls + x;
END_FUNCTION
PROGRAM P
VAR
  q, r : INT; d : DINT; t : DINT; e : BOOL; flags : ARRAY[0..7] OF BOOL; i : INT := 3;
  lamp AT %QX0.5 : BOOL; w : WORD;
END_VAR
VAR_TEMP keep : DINT; END_VAR
q := Div2(a := 7, rest => r, exact => e, total := t, flag := flags[i]);
q := q + Div2(9, 3, d, e, t, lamp);
Div2(a := 1, total := keep, flag := w.4);
t := t + keep * 1000;
Note(x := 10);
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    let names = [
        "q", "r", "d", "e", "t", "flags[3]", "flags[2]", "lamp", "w", "calls",
    ];
    let values: Vec<String> = names.iter().map(|n| m.text(n)).collect();
    assert_eq!(
        values,
        [
            "6", "1", "0", "TRUE", "1016", "TRUE", "FALSE", "TRUE", "16", "13"
        ]
    );
}

#[test]
fn function_blocks_keep_their_state_apart() {
    let text = "
FUNCTION_BLOCK Filter
VAR_INPUT x : REAL; gain : REAL := 0.5; END_VAR
VAR_OUTPUT y : REAL; n : INT; END_VAR
VAR first : BOOL := TRUE; END_VAR
VAR CONSTANT Start : REAL := 1.0; END_VAR
VAR_TEMP delta : REAL; END_VAR
IF first THEN y := Start; first := FALSE; END_IF;
delta := x - y;
y := y + gain * delta;
n := n + 1;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Pair
VAR_INPUT x : REAL; END_VAR
VAR a, b : Filter; list : ARRAY[1..2] OF Filter := [(gain := 1.0), (gain := 0.25)]; i : INT; END_VAR
VAR_OUTPUT sum : REAL; END_VAR
a(x := x);
b(x := a.y, gain := 0.1);
FOR i := 1 TO 2 DO list[i](x := x); END_FOR;
sum := a.y + b.y + list[1].y + list[2].y;
END_FUNCTION_BLOCK
PROGRAM P
VAR p1, p2 : Pair; alone : Filter := (x := 4.0); z : REAL; k : INT; END_VAR
p1(x := 3.0);
p1(x := 3.0, sum => z);
p2(x := 1.0);
alone.x := 5.0;
alone(n => k);
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    // a: 1 > 2 > 2.5; b: 1 > 1.1 > 1.24; list: 3, 3 and 1.5, 1.875
    assert_eq!(m.text("p1.a.y"), "2.5");
    let Value::Real(z) = m.get("z") else { panic!() };
    assert!((z - (2.5 + 1.24 + 3.0 + 1.875)).abs() < 1e-5, "{z}");
    assert_eq!(m.text("p2.sum"), "4.0");
    assert_eq!(m.text("p1.list[2].n"), "2");
    assert_eq!(m.text("alone.y"), "3.0");
    assert_eq!(m.text("k"), "1");
}

#[test]
fn programs_call_programs_and_share_globals() {
    let text = "
VAR_GLOBAL g : INT := 1; END_VAR
PROGRAM A VAR_INPUT step : INT := 2; END_VAR VAR_OUTPUT n : INT; END_VAR g := g + step; n := n + 1; END_PROGRAM
PROGRAM P VAR seen : INT; END_VAR A(); A(step := 10, n => seen); g := g * 2; seen := seen * 10 + A.n; END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    assert_eq!(
        (m.text("g"), m.text("seen"), m.text("A.step")),
        ("26".into(), "22".into(), "10".into())
    );
}

#[test]
fn located_variables_are_the_process_image() {
    let text = "
VAR_GLOBAL
  i_bit AT %IX1.7 : BOOL; i_byte AT %IB2 : SINT; i_int AT %IW2 : INT; i_real AT %ID2 : REAL; i_long AT %IL2 : LINT;
  q_bit AT %QX0.2 : BOOL := TRUE; q_byte AT %QB1 : BYTE; q_int AT %QW1 : INT := -2; q_real AT %QD1 : REAL; q_time AT %QL1 : TIME;
  q_list AT %QB16 : ARRAY[0..3] OF BYTE;
END_VAR
PROGRAM P VAR k : INT := 2; END_VAR
q_bit := i_bit; q_byte := SINT_TO_BYTE(i_byte); q_int := i_int; q_real := i_real; q_time := LINT_TO_TIME(i_long);
q_list[k] := 16#AA; %QX0.7 := NOT %IX0.0; %QW12 := 16#0102;
END_PROGRAM";
    let mut m = Machine::new(text);
    assert_eq!(m.instance.outputs()[0], 4);
    assert_eq!(m.instance.outputs()[2..4], [0xfe, 0xff]);
    let inputs = m.instance.inputs_mut();
    inputs[1] = 0x80;
    inputs[2] = 0x85;
    inputs[4..6].copy_from_slice(&(-300i16).to_le_bytes());
    inputs[8..12].copy_from_slice(&1.5f32.to_le_bytes());
    inputs[16..24].copy_from_slice(&(-9i64).to_le_bytes());
    m.scan();
    let mut expected = [0u8; 32];
    expected[0] = 0b1000_0100;
    expected[1] = 0x85;
    expected[2..4].copy_from_slice(&(-300i16).to_le_bytes());
    expected[4..8].copy_from_slice(&1.5f32.to_le_bytes());
    expected[8..16].copy_from_slice(&(-9i64).to_le_bytes());
    expected[18] = 0xaa;
    expected[24..26].copy_from_slice(&[2, 1]);
    assert_eq!(m.instance.outputs(), expected);
    assert_eq!(m.text("i_byte"), "-123");
    assert_eq!(m.text("q_int"), "-300");
}

/// Runs a block with its input from a timing diagram and answers Q and ET in ms after each scan of 10 ms.
fn timing(block: &str, pt_ms: u32, input: &str) -> Vec<(bool, i64)> {
    let text = format!(
        "PROGRAM P VAR_INPUT x : BOOL; END_VAR VAR t : {block}; END_VAR t(IN := x, PT := T#{pt_ms}ms); END_PROGRAM"
    );
    let mut m = Machine::new(&text);
    m.time_ns = 5 * CYCLE_NS;
    input
        .chars()
        .map(|c| {
            m.set("x", Value::Bool(c == '1'));
            m.scan();
            let Value::Time(et) = m.get("t.ET") else {
                panic!()
            };
            (m.get("t.Q") == Value::Bool(true), et / 1_000_000)
        })
        .collect()
}

#[test]
fn timers_follow_the_timing_diagrams() {
    let f = false;
    let t = true;
    assert_eq!(
        timing("TON", 20, "0111101011110"),
        [
            (f, 0),
            (f, 0),
            (f, 10),
            (t, 20),
            (t, 20),
            (f, 0),
            (f, 0),
            (f, 0),
            (f, 0),
            (f, 10),
            (t, 20),
            (t, 20),
            (f, 0)
        ]
    );
    assert_eq!(
        timing("TOF", 20, "0110100001"),
        [
            (f, 0),
            (t, 0),
            (t, 0),
            (t, 0),
            (t, 0),
            (t, 0),
            (t, 10),
            (f, 20),
            (f, 20),
            (t, 0)
        ]
    );
    assert_eq!(
        timing("TP", 20, "01000111110"),
        [
            (f, 0),
            (t, 0),
            (t, 10),
            (f, 0),
            (f, 0),
            (t, 0),
            (t, 10),
            (f, 20),
            (f, 20),
            (f, 20),
            (f, 0)
        ]
    );
    assert_eq!(timing("TON", 0, "01"), [(f, 0), (t, 0)]);
}

#[test]
fn counters_edges_and_latches() {
    let text = "
PROGRAM P
VAR_INPUT x, y, z : BOOL; END_VAR
VAR
  up : CTU; down : CTD; both : CTUD_DINT; r : R_TRIG; f : F_TRIG; sr1 : SR; rs1 : RS;
  rising, falling : INT;
END_VAR
up(CU := x, R := z, PV := 2);
down(CD := x, LD := y, PV := 3);
both(CU := x, CD := y, R := z, LD := FALSE, PV := 2);
r(CLK := x); IF r.Q THEN rising := rising + 1; END_IF;
f(CLK := x); IF f.Q THEN falling := falling + 1; END_IF;
sr1(S1 := x, R := y); rs1(S := x, R1 := y);
END_PROGRAM";
    let mut m = Machine::new(text);
    let mut trace = Vec::new();
    for (x, y, z) in [
        (0, 1, 0),
        (1, 0, 0),
        (1, 0, 0),
        (0, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (1, 0, 0),
        (0, 0, 1),
    ] {
        for (name, v) in [("x", x), ("y", y), ("z", z)] {
            m.set(name, Value::Bool(v == 1));
        }
        m.scan();
        let names = [
            "up.CV", "up.Q", "down.CV", "down.Q", "both.CV", "both.QU", "rising", "falling",
            "sr1.Q1", "rs1.Q1",
        ];
        trace.push(
            names
                .map(|n| m.text(n).replace("TRUE", "T").replace("FALSE", "F"))
                .join(" "),
        );
    }
    assert_eq!(
        trace,
        [
            "0 F 3 F -1 F 0 1 F F",
            "1 F 2 F 0 F 1 1 T T",
            "1 F 2 F 0 F 1 1 T T",
            "1 F 2 F 0 F 1 2 T T",
            "2 T 3 F 0 F 2 2 T F",
            "2 T 3 F 0 F 2 3 F F",
            "3 T 2 F 1 F 3 3 T T",
            "0 F 2 F 0 F 3 4 T T",
        ]
    );
}

#[test]
fn the_right_side_of_and_and_or_guards() {
    let text = "
PROGRAM P VAR a : ARRAY[1..3] OF INT; i, d : INT; ok, r : BOOL; END_VAR
IF (i >= 1) AND (a[i] > 0) THEN ok := TRUE; END_IF;
r := d = 0 OR 10 / d > 1;
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    assert_eq!((m.text("ok"), m.text("r")), ("FALSE".into(), "TRUE".into()));
}
