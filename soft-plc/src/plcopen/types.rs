//! Types and initial values of PLCopen XML.

use roxmltree::Node;

use super::{Reader, element, elements};
use crate::diag::Problem;
use crate::syntax::ast::{Expr, ExprKind, Ident, Init, TypeSpec, TypeSpecKind};
use crate::syntax::parser::{parse_whole_expression, parse_whole_init};

/// How deep types and values may be nested.
const DEPTH_MAX: usize = 100;

impl Reader<'_> {
    /// The type that stands as the first element inside `holder` (`type`, `baseType`, `returnType`).
    pub fn type_spec(&mut self, holder: Node<'_, '_>) -> Option<TypeSpec> {
        let span = self.tag(holder);
        if holder.ancestors().count() > DEPTH_MAX {
            self.report(Problem::error("E608", span, "types are nested too deeply"));
            return None;
        }
        let Some(node) = holder.first_element_child() else {
            let message = format!("<{}> is empty", holder.tag_name().name());
            self.report(Problem::error("E608", span, message).expected("a type"));
            return None;
        };
        let span = self.tag(node);
        let kind = match node.tag_name().name() {
            "derived" => TypeSpecKind::Named(self.name(node, "name")?),
            "string" | "wstring" => TypeSpecKind::Str {
                wide: node.tag_name().name() == "wstring",
                len: match node.attribute("length") {
                    Some(text) if !text.trim().is_empty() => {
                        Some(Box::new(self.expression(node, "length")?))
                    }
                    _ => None,
                },
            },
            "array" => {
                let mut dims = Vec::new();
                let mut open = 0;
                for dimension in elements(node, "dimension") {
                    let is_open = |bound| dimension.attribute(bound).map(str::trim) == Some("*");
                    if is_open("lower") && is_open("upper") {
                        open += 1;
                    } else {
                        dims.push(self.bounds(dimension)?);
                    }
                }
                let Some(base) = element(node, "baseType") else {
                    self.report(Problem::error("E606", span, "<array> has no <baseType>"));
                    return None;
                };
                let elem = Box::new(self.type_spec(base)?);
                if open > 0 && dims.is_empty() {
                    TypeSpecKind::OpenArray { dims: open, elem }
                } else if open > 0 {
                    self.report(
                        Problem::error(
                            "E606",
                            span,
                            "an array is open in all dimensions or in none",
                        )
                        .expected("`*` for each bound, or none"),
                    );
                    return None;
                } else {
                    TypeSpecKind::Array { dims, elem }
                }
            }
            "subrangeSigned" | "subrangeUnsigned" => {
                let (lo, hi) = self.bounds(element(node, "range")?)?;
                let base = self.type_spec(element(node, "baseType")?)?;
                let TypeSpecKind::Named(base) = base.kind else {
                    self.report(Problem::error(
                        "E608",
                        span,
                        "a subrange needs an integer type",
                    ));
                    return None;
                };
                TypeSpecKind::Subrange {
                    base,
                    lo: Box::new(lo),
                    hi: Box::new(hi),
                }
            }
            "enum" => {
                let mut values = Vec::new();
                for value in elements(element(node, "values")?, "value") {
                    let name = self.name(value, "name")?;
                    let number = match value.attribute("value") {
                        Some(text) if !text.trim().is_empty() => {
                            Some(self.expression(value, "value")?)
                        }
                        _ => None,
                    };
                    values.push((name, number));
                }
                let base = match element(node, "baseType") {
                    Some(base) => match self.type_spec(base)?.kind {
                        TypeSpecKind::Named(base) => Some(base),
                        _ => None,
                    },
                    None => None,
                };
                TypeSpecKind::Enum { base, values }
            }
            "struct" => {
                let mut fields = Vec::new();
                for variable in elements(node, "variable") {
                    fields.extend(self.variable(variable));
                }
                TypeSpecKind::Struct {
                    // The format has no word for it: whose fields have addresses that overlap says so by them.
                    overlap: true,
                    fields,
                }
            }
            "pointer" => {
                TypeSpecKind::Pointer(Box::new(self.type_spec(element(node, "baseType")?)?))
            }
            // Elementary types are elements of their own: <INT />.
            name => TypeSpecKind::Named(Ident {
                name: name.to_owned(),
                span,
            }),
        };
        Some(TypeSpec { kind, span })
    }

    fn bounds(&mut self, node: Node<'_, '_>) -> Option<(Expr, Expr)> {
        Some((
            self.expression(node, "lower")?,
            self.expression(node, "upper")?,
        ))
    }

    fn expression(&mut self, node: Node<'_, '_>, attribute: &str) -> Option<Expr> {
        let Some(part) = self.attribute_part(node, attribute) else {
            let span = self.tag(node);
            let message = format!("<{}> has no `{attribute}`", node.tag_name().name());
            self.report(Problem::error("E606", span, message));
            return None;
        };
        match parse_whole_expression(part.source, &part.text, part.base) {
            Ok(expr) => Some(expr),
            Err(problems) => {
                problems.into_iter().for_each(|p| self.report(p));
                None
            }
        }
    }

    /// The value inside `<initialValue>` or `<value>`.
    pub fn initial_value(&mut self, holder: Node<'_, '_>) -> Option<Init> {
        let node = holder.first_element_child()?;
        let span = self.tag(node);
        if node.ancestors().count() > DEPTH_MAX {
            self.report(Problem::error("E608", span, "values are nested too deeply"));
            return None;
        }
        match node.tag_name().name() {
            "simpleValue" => {
                let part = self.attribute_part(node, "value")?;
                if part.text.trim().is_empty() {
                    return None;
                }
                match parse_whole_init(part.source, &part.text, part.base) {
                    Ok(init) => Some(init),
                    Err(problems) => {
                        problems.into_iter().for_each(|p| self.report(p));
                        None
                    }
                }
            }
            "arrayValue" => {
                let mut items = Vec::new();
                for value in elements(node, "value") {
                    let count = match value
                        .attribute("repetitionValue")
                        .and_then(|c| c.trim().parse::<i128>().ok())
                    {
                        Some(1) | None => None,
                        Some(count) => Some(Expr {
                            kind: ExprKind::Int(count),
                            span: self.attribute_span(value, "repetitionValue"),
                        }),
                    };
                    items.push((count, self.initial_value(value)?));
                }
                Some(Init::Array(items, span))
            }
            "structValue" => {
                let mut items = Vec::new();
                for value in elements(node, "value") {
                    let member = self.name(value, "member")?;
                    items.push((member, self.initial_value(value)?));
                }
                Some(Init::Struct(items, span))
            }
            other => {
                let message = format!("<{other}> is no initial value");
                self.report(Problem::error("E608", span, message));
                None
            }
        }
    }
}
