// The binding for Kotlin on a JVM. Run by scripts/phones/run.py:
//
//     seals PROFILE FRAMES_FOLDER REPEAT                                    queries equal the library's to the bit
//     locate HOST PORT MAP MODEL WIDTH,HEIGHT,PARAMS POSES FRAME.pgm...     the example's Localizer against a service
import java.io.File
import java.nio.ByteBuffer
import org.veiloc.Alignment
import org.veiloc.Answer
import org.veiloc.Axes
import org.veiloc.Burst
import org.veiloc.BurstOptions
import org.veiloc.Camera
import org.veiloc.CameraPose
import org.veiloc.Cancellation
import org.veiloc.ContentAnchors
import org.veiloc.Focal
import org.veiloc.FrameFormat
import org.veiloc.FrameLayout
import org.veiloc.Mask
import org.veiloc.MaskKind
import org.veiloc.Pack
import org.veiloc.PackUse
import org.veiloc.Pose
import org.veiloc.Profile
import org.veiloc.SealOptions
import org.veiloc.Sealer
import org.veiloc.Session
import org.veiloc.VeilocException
import org.veiloc.advice
import org.veiloc.adviceText
import org.veiloc.example.Localizer
import org.veiloc.composedPose
import org.veiloc.croppedCamera
import org.veiloc.pinholeCamera
import org.veiloc.poseFromMatrix
import org.veiloc.rigBytes

fun direct(bytes: ByteArray): ByteBuffer = ByteBuffer.allocateDirect(bytes.size).put(bytes).flip() as ByteBuffer

inline fun <reified E : VeilocException> expect(what: String, body: () -> Unit) {
    try {
        body()
    } catch (error: VeilocException) {
        check(error is E && (error.message ?: "").length > 5) { "$what: $error" }
        return
    }
    error("$what: no exception")
}

fun seals(arguments: List<String>) {
    val profile = Profile(File(arguments[0]).readBytes())
    check(profile.id().length == 32)
    val sealer = Sealer(profile)
    val folder = File(arguments[1])
    Answer(folder.resolve("answer").readBytes()).use { answer ->
        check(answer.toJson() == folder.resolve("answer.json").readText()) { "the document of an answer" }
        check(answer.metresPerUnit() == 1.0 && answer.down() == listOf(0.0, -1.0, 0.0))
    }
    val repeat = arguments[2].toInt()
    var count = 0
    for (line in folder.resolve("frames.txt").readLines()) {
        val words = line.split(" ")
        val number = words[0].toInt()
        val layout = FrameLayout(FrameFormat.RGBA, words[1].toUInt(), words[2].toUInt())
        val camera = Camera(words[3], layout.width, layout.height, words.drop(4).map { it.toDouble() }, Focal.CALIBRATED)
        val pixels = direct(folder.resolve("$number.rgba").readBytes())
        val expected = folder.resolve("$number.query").readBytes()
        val seed = ByteArray(32) { number.toByte() }
        repeat(if (count == 0) repeat + 1 else 1) {
            sealer.sealSeeded(sealer.extract(pixels, layout, camera), seed).use { query ->
                check(query.bytes().contentEquals(expected)) { "frame $number differs" }
                check(query.steps().last() == query.rows() && query.bytes(query.steps().first()).size <= expected.size)
            }
        }
        if (count == 0) {
            border(profile, pixels, layout, camera)
            packs(folder, pixels, layout, camera)
            masks(sealer, folder, layout, camera)
        }
        count++
    }
    println("$count queries equal, $repeat repeated")
}

/** Nothing under a mask reaches the query (rule L13): a frame with other pixels there gives the query of the reference. */
fun masks(sealer: Sealer, folder: File, layout: FrameLayout, camera: Camera) {
    val mask = Mask(MaskKind.ARCORE_SEMANTICS, 40u, 30u, folder.resolve("mask").readBytes(), 48u)
    val hidden = direct(folder.resolve("hidden.rgba").readBytes())
    sealer.sealSeeded(sealer.extract(hidden, layout, camera, mask = mask), ByteArray(32)).use {
        check(it.bytes().contentEquals(folder.resolve("masked").readBytes())) { "the mask does not hide" }
    }
    expect<VeilocException.Image>("a short mask") { sealer.extract(hidden, layout, camera, mask = mask.copy(height = 99u)) }
    expect<VeilocException.Image>("a margin") { sealer.extract(hidden, layout, camera, mask = mask.copy(margin = -1f)) }
    // In a burst, too: an equal choice of frames, and no error.
    val still = CameraPose(Axes.OPEN_GL, Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    check(Burst().offer(hidden, layout, camera, still, 1.0, mask))
}

/** The first frame sealed with the pack: equal to the reference, or refused where the frame does not show the place. */
fun packs(folder: File, pixels: ByteBuffer, layout: FrameLayout, camera: Camera) {
    val bytes = folder.resolve("pack").readBytes()
    val expected = folder.resolve("matched").readBytes()
    expect<VeilocException.Pack>("a damaged pack") { Pack(bytes.copyOf(bytes.size - 1)) }
    val pack = Pack(bytes)
    val profile = pack.profile()
    check(pack.id().length == 32 && profile.id().length == 32)
    expect<VeilocException.Argument>("explained without a pack") { Sealer(profile, SealOptions(send = PackUse.EXPLAINED)) }
    val sealer = Sealer(profile, SealOptions(pack = pack))
    pack.close()
    val extracted = sealer.extract(pixels, layout, camera)
    if (expected.isEmpty()) {
        expect<VeilocException.NotThisPlace>("another place") { sealer.sealSeeded(extracted, ByteArray(32)) }
    } else {
        sealer.sealSeeded(extracted, ByteArray(32)).use { check(it.bytes().contentEquals(expected)) { "matches differ" } }
    }
    // Two squares have fewer keypoints than a place must explain.
    val width = layout.width.toInt()
    val squares = ByteArray(width * layout.height.toInt()) {
        val (column, row) = Pair(it % width / 20, it / width / 20)
        if (row == 7 && (column == 7 || column == 14)) 30 else 120
    }
    expect<VeilocException.NotThisPlace>("two squares") {
        sealer.seal(sealer.extract(direct(squares), layout.copy(format = FrameFormat.GRAY), camera))
    }
}

/** Errors, sessions and poses. */
fun border(profile: Profile, pixels: ByteBuffer, layout: FrameLayout, camera: Camera) {
    val sealer = Sealer(profile)
    expect<VeilocException.Profile>("a profile") { Profile(ByteArray(10)) }
    expect<VeilocException.Answer>("an answer") { Answer(ByteArray(0)) }
    expect<VeilocException.SessionBytes>("a session") { Session.fromBytes(ByteArray(3)) }
    expect<VeilocException.Argument>("anchors") { Session("nowhere") }
    expect<VeilocException.Argument>("a turn") { sealer.extract(pixels, layout.copy(turnDegrees = 45), camera) }
    expect<VeilocException.Image>("a stride") { sealer.extract(pixels, layout.copy(rowStride = 5u), camera) }
    expect<VeilocException.Image>("a size") { sealer.extract(pixels, layout, camera.copy(width = 1u)) }
    expect<VeilocException.Seal>("points") { Sealer(profile, SealOptions("points")) }
    val dark = direct(ByteArray((layout.width * layout.height).toInt()))
    expect<VeilocException.Texture>("a black frame") {
        sealer.seal(sealer.extract(dark, layout.copy(format = FrameFormat.GRAY), camera))
    }
    expect<VeilocException.Argument>("a unit") { Alignment(0.0) }
    // Cancelled before it begins, and by another thread while it runs or before the next one.
    val cancellation = Cancellation()
    val untouched = Session()
    val own = sealer.extract(pixels, layout, camera, cancellation = cancellation)
    sealer.inSession(untouched).seal(own).close()
    expect<VeilocException.Argument>("an image is sealed once") { sealer.seal(own) }
    Thread { cancellation.cancel() }.start()
    expect<VeilocException.Cancelled>("a cancelled call") {
        while (true) sealer.extract(pixels, layout, camera, cancellation = cancellation).close()
    }
    expect<VeilocException.Cancelled>("a call after it") {
        sealer.extract(pixels, layout, camera, cancellation = cancellation)
    }
    check(cancellation.isCancelled() && untouched.frames() == 1u)
    val upright = CameraPose(Axes.OPEN_GL, Pose(1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))
    val session = Session("gravity")
    val first = Sealer(profile, SealOptions(sendGravity = false)).inSession(session).seal(sealer.extract(pixels, layout, camera, upright))
    val restored = Session.fromBytes(session.toBytes())
    val second = sealer.inSession(restored).seal(sealer.extract(pixels, layout, camera, upright))
    check(restored.frames() == 2u && session.frames() == 1u && restored.starts() == 1u)
    val rig = rigBytes(listOf(first, second), listOf(upright, upright), 1.0, 0.5, 0.01)
    check(String(rig, 0, 6) == "vqrig1" && rig[7].toInt() == 2)
    bursts(profile, pixels, layout, camera, upright)
    val pose = poseFromMatrix(listOf(0f, 0f, 1f, 0f, 0f, 1f, 0f, 0f, -1f, 0f, 0f, 0f, 1f, 1.5f, -2f, 1f))
    check(pose.x == 1.0 && pose.z == -2.0 && Math.abs(pose.qy + Math.sqrt(0.5)) < 1e-6)
    val part = croppedCamera(pinholeCamera(4u, 4u, 1.0, 1.0, 2.0, 2.0), 1u, 0u, 3u, 2u)
    check(part.params == listOf(1.0, 1.0, 1.0, 2.0) && part.width == 3u && part.height == 2u)
    expect<VeilocException.Argument>("a part") { croppedCamera(part, 1u, 0u, 3u, 2u) }
    val lens = composedPose(pose, Pose(0.0, 0.0, -0.5, 0.0, 0.0, 0.0, 1.0))
    check(Math.abs(lens.x - 1.5) < 1e-6 && Math.abs(lens.z + 2.0) < 1e-6)
    check(Alignment().worldFromAnchor(Axes.UNITY, pose) == null)
    expect<VeilocException.Answer>("no anchors") { ContentAnchors(ByteArray(3)) }
    check(ContentAnchors("""{"version":1,"anchors":[]}""".toByteArray()).place(Alignment(), upright).isEmpty())
}

/** The newest frame is the rig, a black one is left out, and a burst without texture leaves the session. */
fun bursts(profile: Profile, pixels: ByteBuffer, layout: FrameLayout, camera: Camera, upright: CameraPose) {
    expect<VeilocException.Argument>("six frames") { Burst(BurstOptions(frames = 6u)) }
    val burst = Burst(BurstOptions(metresPerUnit = 1.0))
    val (session, sealer) = Pair(Session(), Sealer(profile, SealOptions(maxKeypoints = 512u)))
    val dark = direct(ByteArray((layout.width * layout.height).toInt()))
    val gray = layout.copy(format = FrameFormat.GRAY)
    expect<VeilocException.Argument>("a time") { burst.offer(pixels, layout, camera, upright, Double.NaN) }
    expect<VeilocException.Argument>("no frame") { burst.seal(sealer, session) }
    check(burst.offer(dark, gray, camera, upright, 1.0) && !burst.offer(dark, gray, camera, upright, 1.0))
    expect<VeilocException.Texture>("a black burst") { burst.seal(sealer, session) }
    check(burst.frames() == 0u && session.frames() == 0u)
    val moved = CameraPose(upright.axes, upright.pose.copy(x = 1.02))
    burst.offer(pixels, layout, camera, upright, 2.0)
    burst.offer(dark, gray, camera, upright, 2.4)
    burst.offer(pixels, layout, camera, moved, 2.8)
    check(burst.frames() == 3u)
    burst.seal(sealer, session).use { sealed ->
        check(sealed.frames() == 2u && sealed.leftOut() == 1u && session.frames() == 2u)
        check(Math.abs(sealed.cameraInWorld(Axes.OPEN_GL).pose.x - 1.02) < 1e-9)
        check(String(sealed.bytes(), 0, 6) == "vqrig1" && sealed.bytes()[7].toInt() == 2)
        check(adviceText(advice(sealed.newest(), null)).length > 5)
    }
    // In an unknown unit the distance between frames has no meaning.
    Burst().use { unknown ->
        unknown.offer(pixels, layout, camera, upright, 2.0)
        unknown.offer(pixels, layout, camera, moved, 2.8)
        unknown.seal(sealer, session).use { check(it.frames() == 1u && it.leftOut() == 0u) }
    }
    burst.offer(pixels, layout, camera, moved, 3.2)
    burst.clear()
    check(burst.frames() == 0u)
}

fun locate(arguments: List<String>) {
    val (width, height) = arguments[4].split(",")
    val params = arguments[4].split(",").drop(2).map { it.toDouble() }
    val layout = FrameLayout(FrameFormat.GRAY, width.toUInt(), height.toUInt())
    val camera = Camera(arguments[3], layout.width, layout.height, params, Focal.CALIBRATED)
    val poses = File(arguments[5]).readLines().map { line -> line.split(" ").map { it.toDouble() } }
    Localizer("http://${arguments[0]}:${arguments[1]}", arguments[2]).use { localizer ->
        arguments.drop(6).forEachIndexed { i, path ->
            val file = File(path).readBytes()
            val size = (layout.width * layout.height).toInt()
            val p = poses[i]
            val pose = CameraPose(Axes.OPEN_GL, Pose(p[1], p[2], p[3], p[4], p[5], p[6], p[7]))
            localizer.offer(direct(file.copyOfRange(file.size - size, file.size)), layout, camera, pose, p[0])
            if (localizer.frames() < 3) return@forEachIndexed
            val result = localizer.locate()
            result.answer?.use {
                val found = it.cameraInMap(Axes.OPEN_GL)
                println("$i ${if (it.trusted()) "trusted" else "doubtful"} ${found.x} ${found.y} ${found.z} ${result.update}")
            }
            println("  ${result.words}")
        }
        val info = localizer.alignment.info()
        println("alignment state ${info.state.ordinal} used ${info.used} distances ${info.distances.ordinal}")
        val anchor = localizer.worldFromAnchor(Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))!!
        println("anchor ${anchor.x} ${anchor.y} ${anchor.z} ${anchor.qx} ${anchor.qy} ${anchor.qz} ${anchor.qw}")
    }
}

fun main(arguments: Array<String>) {
    val rest = arguments.drop(1)
    if (arguments.firstOrNull() == "seals") seals(rest) else locate(rest)
}
