//! Meshes as pure values: shapes in metres, colours and normals. No light, no backend.

pub(crate) mod builder;
pub(crate) mod hall;
pub(crate) mod items;
pub(crate) mod rack;
pub(crate) mod wall;
