// Mean of a pixel's samples in linear light. What a method does not know is -1, in the only sample that it then has.

override SAMPLES: u32 = 1;

// `first` is the layer of the first sample. Who imports this binds `luminance_layers`: naga writes no storage texture as an
// argument for Metal.
fn mean_of_samples(pixel: vec2<u32>, first: u32) -> f32 {
    var sum = 0.0;
    for (var s = 0u; s < SAMPLES; s++) {
        sum += textureLoad(luminance_layers, pixel, first + s).r;
    }
    return sum * (1.0 / f32(SAMPLES));
}
