//! Semantic classes of the built-in scenes. 0 is what has no class: background and sky.

/// Floor, road, pavement, table top.
pub const GROUND: u32 = 1;
/// Walls, ceilings, buildings and what is fixed to them.
pub const BUILDING: u32 = 2;
/// Shelves, desks, benches.
pub const FURNITURE: u32 = 3;
/// Cartons, crates, pallets, barrels.
pub const GOODS: u32 = 4;
/// What flies, rolls or spins by itself.
pub const MOVING: u32 = 5;
/// Cars.
pub const VEHICLE: u32 = 6;
/// Lamp posts, signs, pipes.
pub const POLE: u32 = 7;
/// Trees and plants.
pub const PLANT: u32 = 8;
/// Lamps and lit signs.
pub const LAMP: u32 = 9;
/// Books, mugs, pens.
pub const THING: u32 = 10;

/// Every class with its name.
pub const NAMES: [(u32, &str); 10] = [
    (GROUND, "ground"),
    (BUILDING, "building"),
    (FURNITURE, "furniture"),
    (GOODS, "goods"),
    (MOVING, "moving"),
    (VEHICLE, "vehicle"),
    (POLE, "pole"),
    (PLANT, "plant"),
    (LAMP, "lamp"),
    (THING, "thing"),
];
