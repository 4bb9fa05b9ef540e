// Rays a second of Embree on one core, over a file that `cargo bench --bench rays -- FOLDER` wrote.
// Prints millions of any-hit and of closest-hit rays a second and the share of rays that hit.
#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif
#include <math.h>
#include <pmmintrin.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static double seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static struct RTCRay ray_of(const float *r) {
    struct RTCRay ray = {.org_x = r[0], .org_y = r[1], .org_z = r[2], .dir_x = r[3], .dir_y = r[4], .dir_z = r[5],
                         .tfar = INFINITY, .mask = ~0u};
    return ray;
}

int main(int argc, char **argv) {
    FILE *file = argc > 1 ? fopen(argv[1], "rb") : NULL;
    uint32_t count[3];
    if (!file || fread(count, 4, 3, file) != 3) return fprintf(stderr, "usage: embree FILE.rays\n"), 1;
    RTCDevice device = rtcNewDevice("threads=1");
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    void *positions = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, count[0]);
    void *corners = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, count[1]);
    float *rays = malloc(24 * (size_t)count[2]);
    if (!rays || fread(positions, 12, count[0], file) != count[0] || fread(corners, 12, count[1], file) != count[1] ||
        fread(rays, 24, count[2], file) != count[2])
        return fprintf(stderr, "%s is cut short\n", argv[1]), 1;
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
    // Watertight, as the other side is.
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    rtcCommitScene(scene);
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
#if RTC_VERSION_MAJOR < 4
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
#define CONTEXT &context,
#define LAST
#else
#define CONTEXT
#define LAST , NULL
#endif
    double any = 0, closest = 0;
    size_t hits = 0;
    for (int pass = 0; pass < 3; pass++) {
        size_t blocked = 0;
        hits = 0;
        double start = seconds();
        for (size_t i = 0; i < count[2]; i++) {
            struct RTCRay ray = ray_of(rays + 6 * i);
            rtcOccluded1(scene, CONTEXT &ray LAST);
            blocked += ray.tfar < 0;
        }
        double middle = seconds();
        for (size_t i = 0; i < count[2]; i++) {
            struct RTCRayHit ray = {.ray = ray_of(rays + 6 * i), .hit.geomID = RTC_INVALID_GEOMETRY_ID};
            rtcIntersect1(scene, CONTEXT &ray LAST);
            hits += ray.hit.geomID != RTC_INVALID_GEOMETRY_ID;
        }
        double end = seconds();
        if (blocked != hits) fprintf(stderr, "any hit %zu, closest hit %zu\n", blocked, hits);
        any = fmax(any, count[2] / (middle - start) / 1e6);
        closest = fmax(closest, count[2] / (end - middle) / 1e6);
    }
    printf("%.3f %.3f %.5f\n", any, closest, (double)hits / count[2]);
    return 0;
}
