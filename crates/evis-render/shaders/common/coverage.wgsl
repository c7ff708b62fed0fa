// A sensor's pixel in a picture of coverage samples.

// Pixels of the picture along each side of a pixel.
override GRID: u32 = 1;

// Mean of the four coverage samples at each place of the grid.
fn coverage_mean(samples: texture_multisampled_2d<f32>, pixel: vec2<u32>) -> f32 {
    var sum = 0.0;
    for (var place = 0u; place < GRID * GRID; place++) {
        let at = pixel * GRID + vec2<u32>(place % GRID, place / GRID);
        for (var s = 0; s < 4; s++) {
            sum += textureLoad(samples, at, s).r;
        }
    }
    return sum * (0.25 / f32(GRID * GRID));
}
