//! Parsers of a cell that holds a number.

/// Largest measured value; the third power of a larger one overflows f32.
const LARGEST: f64 = 1e12;

/// Parses any finite number; an error describes the cell.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ if text.is_empty() => Err("expected a finite number, found nothing".to_owned()),
        _ if text.contains(',') => {
            Err(format!("expected a number with a decimal point, found `{text}`"))
        }
        _ => Err(format!("expected a finite number, found `{text}`")),
    }
}

/// Parses a measured number, at most [`LARGEST`] in size.
pub(crate) fn measured(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    if value.abs() <= LARGEST {
        Ok(value)
    } else {
        Err(format!("expected a number up to {LARGEST:e}, found `{text}`"))
    }
}
