// Draws a solid with the shaders of the desktop program: see docs/ARCHITECTURE.md, "From the mouse to pixels". Lengths are
// edges of the cube that holds the object; matrices are column-major; cameras have OpenCV axes.

const HEAD = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D; precision highp sampler3D;
`;

const WHOLE = 3;                            // standard deviations to which a splat is drawn
const SHUT = "0.998";                       // coverage from which nothing behind shows: half a step of eight bits
const LOCATIONS = { record_centre: 0, record_conic: 1, record_shape: 2, record_colour: 3, corner: 4, mean: 0, scale: 1, quat: 2 };
for (let k = 0; k < 12; k++) LOCATIONS[`sh_${k}`] = 3 + k;

const JOINT = 0.02;                         // pitches: interpolated depths of atoms seen edge-on are off by more than the
                                            // thousandth of the desktop program, which showed as freckles on faces
const HALF_FADE_LAYERS = "8.0";             // where sums are half floats: 4^-8 is the last that they hold well

const add = (a, b) => a.map((value, i) => value + b[i]);
const times = (a, s) => a.map((value) => value * s);
const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => times(a, 1 / Math.hypot(...a));

// A camera on its orbit, as engine/scene/camera.py has it: angles in degrees about and above `target`.
function orbit(axes, target, azimuth, elevation, distance, fov, width, height) {
    const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
    const level = add(times(axes.first, Math.cos(a)), times(axes.second, Math.sin(a)));
    const towards = add(times(level, Math.cos(e)), times(axes.up, Math.sin(e)));
    const z = times(towards, -1);
    const x = unit(cross(z, add(times(axes.up, Math.cos(e)), times(level, -Math.sin(e)))));
    const y = cross(z, x);
    const eye = add(target, times(towards, distance));
    const focal = height / 2 / Math.tan(fov / 2);
    return { rows: [x, y, z], shift: [-dot(x, eye), -dot(y, eye), -dot(z, eye)], eye, focal, distance, width, height };
}

// The distance at which a ball of this radius just fits the picture.
function fitDistance(radius, fov, aspect) {
    return radius / Math.sin(Math.atan(Math.tan(fov / 2) * Math.min(1, aspect)));
}

function inCamera(camera, plane) {
    const normal = camera.rows.map((row) => dot(row, plane));
    return [...normal, plane[3] - dot(normal, camera.shift)];
}

class Programs {
    constructor(gl, shaders, constants) {
        Object.assign(this, { gl, shaders, constants, compiled: new Map() });
    }

    // The program of two shaders; `defines` as name and text, `varyings` what transform feedback keeps.
    get(vertex, fragment, defines, varyings) {
        const key = JSON.stringify([vertex, fragment, defines]);
        if (!this.compiled.has(key)) this.compiled.set(key, this.link(vertex, fragment, defines, varyings));
        return this.compiled.get(key);
    }

    link(vertex, fragment, defines, varyings) {
        const gl = this.gl, program = gl.createProgram();
        const given = Object.entries({ ...this.constants, ...defines }).map(([name, text]) => `#define ${name} ${text}\n`);
        for (const [type, source] of [[gl.VERTEX_SHADER, this.shaders[vertex]],
                                      [gl.FRAGMENT_SHADER, fragment ? this.shaders[fragment] : "void main() {}"]]) {
            const shader = gl.createShader(type);
            gl.shaderSource(shader, HEAD + given.join("") + source);
            gl.compileShader(shader);
            if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
                throw new Error(`${vertex}, ${fragment}: ${gl.getShaderInfoLog(shader)}`);
            gl.attachShader(program, shader);
        }
        if (varyings) gl.transformFeedbackVaryings(program, varyings, gl.INTERLEAVED_ATTRIBS);
        for (const [name, location] of Object.entries(LOCATIONS)) gl.bindAttribLocation(program, location, name);
        gl.linkProgram(program);
        if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
            throw new Error(`${vertex}, ${fragment}: ${gl.getProgramInfoLog(program)}`);
        const uniforms = [];
        for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
            const { name, type } = gl.getActiveUniform(program, i);
            uniforms.push({ name: name.replace("[0]", ""), type, location: gl.getUniformLocation(program, name) });
        }
        return { program, uniforms };
    }

    // Makes a program current and sets all of its uniforms; a texture is bound to the next unit.
    use({ program, uniforms }, values) {
        const gl = this.gl;
        gl.useProgram(program);
        let unit = 0;
        for (const { name, type, location } of uniforms) {
            const value = values[name];
            if (value === undefined) throw new Error(`no value for ${name}`);
            if (type === gl.FLOAT) gl.uniform1f(location, value);
            else if (type === gl.INT) gl.uniform1i(location, value);
            else if (type === gl.FLOAT_VEC2) gl.uniform2fv(location, value);
            else if (type === gl.FLOAT_VEC3) gl.uniform3fv(location, value);
            else if (type === gl.FLOAT_VEC4) gl.uniform4fv(location, value);
            else if (type === gl.FLOAT_MAT4) gl.uniformMatrix4fv(location, false, value);
            else {
                gl.activeTexture(gl.TEXTURE0 + unit);
                gl.bindTexture(type === gl.SAMPLER_3D ? gl.TEXTURE_3D : gl.TEXTURE_2D, value);
                gl.uniform1i(location, unit++);
            }
        }
    }
}

class Renderer {
    // Throws an Error with a line for the reader where the browser cannot.
    constructor(canvas, page) {
        const gl = canvas.getContext("webgl2", { antialias: false });
        if (!gl) throw new Error("This page needs WebGL 2, which this browser does not have or has switched off.");
        if (!gl.getExtension("EXT_color_buffer_float"))
            throw new Error("This page needs a graphics card that draws into floating-point textures.");
        Object.assign(this, { gl, page, width: 0, height: 0, drawn: null });
        this.floats = Boolean(gl.getExtension("EXT_float_blend"));
        const constants = { ...page.constants, MAX_PLANES: String(Math.max(page.planes.length, 1)) };
        if (!this.floats) constants.FADE_LAYERS = HALF_FADE_LAYERS;
        this.programs = new Programs(gl, page.shaders, constants);
        this.empty = gl.createVertexArray();
    }

    async load() {
        const { skin, body, inside } = this.page;
        this.loadSkin(await inflated(skin.data));
        const gl = this.gl, data = await inflated(body.data);
        this.body = this.volume(body.shape, false);
        gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
        gl.texSubImage3D(gl.TEXTURE_3D, 0, 0, 0, 0, ...body.shape, gl.RED, gl.UNSIGNED_BYTE, data);
        [this.luma, this.blue, this.red] = await Promise.all(
            [inside.luma, inside.blue, inside.red].map((layers) => this.loadLayers(layers)));
    }

    // Records of engine/export/page/skin.py, from all first bytes, all second bytes, ...
    loadSkin(planes) {
        const gl = this.gl, { count, vectors } = this.page.skin, stride = 16 + 4 * vectors;
        const records = new Uint8Array(count * stride);
        for (let byte = 0; byte < stride; byte++)
            for (let i = 0, from = byte * count; i < count; i++) records[i * stride + byte] = planes[from + i];
        this.atoms = this.arrays(records, stride, 0, [
            ["mean", 3, gl.UNSIGNED_SHORT, true, 0], ["scale", 3, gl.HALF_FLOAT, false, 6], ["quat", 4, gl.BYTE, true, 12],
            ...Array.from({ length: vectors }, (_, k) => [`sh_${k}`, 4, gl.BYTE, true, 16 + 4 * k])]).array;
        const names = ["centre", "conic", "shape", "colour"];
        const made = this.arrays(new Uint8Array(count * 64), 64, 1,
            names.map((name, k) => [`record_${name}`, 4, gl.FLOAT, false, 16 * k]));
        this.records = made.buffer;
        this.splats = made.array;
        this.arrays(new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), 8, 0, [["corner", 2, gl.FLOAT, false, 0]], this.splats);
    }

    arrays(data, stride, divisor, fields, array = this.gl.createVertexArray()) {
        const gl = this.gl, buffer = gl.createBuffer();
        gl.bindVertexArray(array);
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
        for (const [name, size, type, normalised, offset] of fields) {
            const at = LOCATIONS[name];
            gl.enableVertexAttribArray(at);
            gl.vertexAttribPointer(at, size, type, normalised, stride, offset);
            gl.vertexAttribDivisor(at, divisor);
        }
        gl.bindVertexArray(null);
        gl.bindBuffer(gl.ARRAY_BUFFER, null);
        return { array, buffer };
    }

    volume(shape, mipmaps) {
        const gl = this.gl, texture = gl.createTexture();
        gl.bindTexture(gl.TEXTURE_3D, texture);
        const levels = mipmaps ? 1 + Math.floor(Math.log2(Math.max(...shape))) : 1;
        gl.texStorage3D(gl.TEXTURE_3D, levels, gl.R8, ...shape);
        for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R])
            gl.texParameteri(gl.TEXTURE_3D, wrap, gl.CLAMP_TO_EDGE);
        gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MIN_FILTER, mipmaps ? gl.LINEAR_MIPMAP_LINEAR : gl.LINEAR);
        gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
        return texture;
    }

    // Decodes sheets and copies their layers on the graphics card: some browsers add noise to pixels that are read back.
    async loadLayers({ shape: [x, y, z], columns, rows, sheets }) {
        const gl = this.gl, texture = this.volume([x, y, z], true);
        for (let n = 0; n < sheets.length; n++) {
            const picture = await createImageBitmap(new Blob([bytes(sheets[n])], { type: "image/webp" }),
                { colorSpaceConversion: "none", premultiplyAlpha: "none" });
            const sheet = gl.createTexture(), buffer = gl.createFramebuffer();
            gl.bindTexture(gl.TEXTURE_2D, sheet);
            gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, gl.RED, gl.UNSIGNED_BYTE, picture);
            picture.close();
            gl.bindFramebuffer(gl.READ_FRAMEBUFFER, buffer);
            gl.framebufferTexture2D(gl.READ_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, sheet, 0);
            gl.bindTexture(gl.TEXTURE_3D, texture);
            const first = n * columns * rows;
            for (let layer = first; layer < Math.min(z, first + columns * rows); layer++) {
                const at = layer - first, left = (at % columns) * x, top = Math.floor(at / columns) * y;
                gl.copyTexSubImage3D(gl.TEXTURE_3D, 0, 0, 0, layer, left, top, x, y);
            }
            gl.deleteFramebuffer(buffer);
            gl.deleteTexture(sheet);
        }
        gl.bindTexture(gl.TEXTURE_3D, texture);
        gl.generateMipmap(gl.TEXTURE_3D);
        return texture;
    }

    projection() {
        const { degree, vectors, scales } = this.page.skin, names = Array.from({ length: vectors }, (_, k) => `sh_${k}`);
        const [first, rest] = scales.map((value) => value.toExponential(9));
        const unpacked = names.map((name, k) => k ? `${rest} * ${name}` : `vec4(${first}, ${first}, ${first}, ${rest}) * ${name}`);
        return this.programs.get("project.vert.glsl", null, {
            SH_DEGREE: degree, SH_VECTORS: vectors, SH_INPUTS: names.map((name) => `in vec4 ${name};`).join(" "),
            CULLED: 1, SH_UNPACKED: `vec4[](${unpacked.join(", ")})`,
        }, ["record_centre", "record_conic", "record_shape", "record_colour"]);
    }

    splat(part, clipped) {
        return this.programs.get("splat.vert.glsl", "splat.frag.glsl",
            { [part]: 1, ...(clipped && { CLIPPED: 1 }) });
    }

    resize(width, height) {
        if (width === this.width && height === this.height) return;
        const gl = this.gl;
        for (const texture of Object.values(this.textures || {})) gl.deleteTexture(texture);
        for (const buffer of Object.values(this.targets || {})) gl.deleteFramebuffer(buffer);
        Object.assign(this, { width, height, drawn: null });
        const texture = (format) => {
            const made = gl.createTexture();
            gl.bindTexture(gl.TEXTURE_2D, made);
            gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
            for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
                gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
            return made;
        };
        const t = this.textures = {
            front: texture(gl.DEPTH_COMPONENT32F), limit: texture(gl.DEPTH_COMPONENT32F), in_layer: texture(gl.RGBA16F), rims: texture(gl.RGBA16F),
            behind: texture(this.floats ? gl.RGBA32F : gl.RGBA16F), edges: texture(gl.RGBA16F),
            faces: texture(gl.RGBA8), face_depths: texture(gl.R32F), frame: texture(gl.RGBA8),
        };
        const target = (colours, depth) => {
            const made = gl.createFramebuffer();
            gl.bindFramebuffer(gl.FRAMEBUFFER, made);
            colours.forEach((colour, k) =>
                gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, colour, 0));
            gl.drawBuffers(colours.length ? colours.map((_, k) => gl.COLOR_ATTACHMENT0 + k) : [gl.NONE]);
            if (depth) gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, depth, 0);
            return made;
        };
        this.targets = {
            front: target([], t.front), sums: target([t.in_layer, t.rims, t.behind, t.edges], t.limit),
            limit: target([], t.limit),
            faces: target([t.faces, t.face_depths], t.front), frame: target([t.frame]),
        };
    }

    // Planes a, b, c, d keep the side below 0; the background is RGB from 0 to 1.
    draw(camera, planes, background) {
        const gl = this.gl, { width, height, page } = this, { rows, shift, focal } = camera;
        const [x, y, z] = rows, middle = dot(z, [0.5, 0.5, 0.5]) + shift[2];
        const slopes = [width, height].map((side) => 1.3 * side / 2 / focal);
        const near = planes.map((plane) => inCamera(camera, plane));
        const values = {
            view: [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, ...shift, 1],
            to_object: [...x, 0, ...y, 0, ...z, 0, ...camera.eye, 1],
            lens: [focal, focal, width / 2, height / 2], size: [width, height], eye: camera.eye,
            near: 1e-3 * camera.distance, depth_range: [middle - page.reach, 0.5 / page.reach],
            slope_limits: [-slopes[0], slopes[0], -slopes[1], slopes[1]], enlarge: 1,
            plane_count: near.length, planes: near.length ? near.flat() : [0, 0, 0, 0], layer: page.constants.EPSILON_PITCHES * page.pitch,
            tolerance: JOINT * page.pitch, background, group: 0, ...this.textures,
            body: this.body, luma: this.luma, blue: this.blue, red: this.red,
            body_scale: page.body.scale, body_shift: page.body.shift,
            colour_scale: page.inside.scale, colour_shift: page.inside.shift,
        };
        gl.viewport(0, 0, width, height);
        gl.enable(gl.DEPTH_TEST);
        this.drawFaces(camera, planes, near, values);
        this.project(values);
        this.drawSplats(values, near.length > 0);
        gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets.frame);
        this.programs.use(this.programs.get("screen.vert.glsl", "resolve.frag.glsl", { FACES: 1 }), values);
        gl.bindVertexArray(this.empty);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
        gl.bindFramebuffer(gl.FRAMEBUFFER, null); // by a shader: Chromium blits nothing to a canvas that was resized
        this.programs.use(this.programs.get("screen.vert.glsl", "upright.frag.glsl", {}), values);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
    }

    drawFaces(camera, planes, near, values) {
        const gl = this.gl;
        gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets.faces);
        gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
        gl.clearBufferfv(gl.DEPTH, 0, [1]);
        gl.depthFunc(gl.LEQUAL);
        gl.bindVertexArray(this.empty);
        planes.forEach((plane, k) => {
            if (dot(camera.eye, plane) + plane[3] <= 0) return;
            const program = this.programs.get("screen.vert.glsl", "volume_face.frag.glsl", {});
            this.programs.use(program, { ...values, cut_in_camera: near[k], cut_index: k });
            gl.drawArrays(gl.TRIANGLES, 0, 3);
        });
    }

    // The atoms as the camera sees them, kept until it or a plane moves.
    project(values) {
        const gl = this.gl, key = JSON.stringify([values.view, values.lens, values.planes]);
        if (key === this.drawn) return;
        this.drawn = key;
        this.programs.use(this.projection(), values);
        gl.bindVertexArray(this.atoms);
        gl.enable(gl.RASTERIZER_DISCARD);
        gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, this.records);
        gl.beginTransformFeedback(gl.POINTS);
        gl.drawArrays(gl.POINTS, 0, this.page.skin.count);
        gl.endTransformFeedback();
        gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, null);
        gl.disable(gl.RASTERIZER_DISCARD);
    }

    // The depth at the front, then sums of weights in the layer there and before it, and only where these leave gaps of
    // what lies behind: depth tests spare most of the pixels of the far side.
    drawSplats(values, clipped) {
        const gl = this.gl, { front, limit, sums } = this.targets;
        const pass = (part, reach) => {
            gl.bindVertexArray(this.splats);
            this.programs.use(this.splat(part, clipped), { ...values, reach });
            gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.page.skin.count);
        };
        gl.bindFramebuffer(gl.FRAMEBUFFER, front);
        gl.depthFunc(gl.LESS);
        pass("VISIBILITY", Math.sqrt(this.page.constants.CORE_Q));
        const sum = (part, shader, defines) => {
            gl.bindFramebuffer(gl.FRAMEBUFFER, limit);
            gl.depthMask(true);
            gl.depthFunc(gl.ALWAYS);
            this.programs.use(this.programs.get("screen.vert.glsl", shader, defines), values);
            gl.bindVertexArray(this.empty);
            gl.drawArrays(gl.TRIANGLES, 0, 3);
            gl.bindFramebuffer(gl.FRAMEBUFFER, sums);
            gl.depthMask(false);
            gl.depthFunc(gl.LEQUAL);
            pass(part, WHOLE);
        };
        gl.bindFramebuffer(gl.FRAMEBUFFER, sums);
        for (let k = 0; k < 4; k++) gl.clearBufferfv(gl.COLOR, k, [0, 0, 0, 0]);
        gl.enable(gl.BLEND);
        gl.blendFunc(gl.ONE, gl.ONE);
        sum("NEAR_PART", "limit.frag.glsl", {});
        sum("FAR_PART", "gaps.frag.glsl", { SHUT, FACES: 1 });
        gl.depthMask(true);
        gl.disable(gl.BLEND);
        gl.disable(gl.DEPTH_TEST);
    }
}

function bytes(base64) {
    const text = atob(base64), out = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
    return out;
}

async function inflated(base64) {
    const stream = new Blob([bytes(base64)]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}
