//! Tests of the regression on tables as a user gives them.

mod ill_posed;
mod line;
mod table;
