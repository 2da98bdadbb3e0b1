//! The world and its tasks as pure values: layout, items, dynamics, routes, tasks, cases.
