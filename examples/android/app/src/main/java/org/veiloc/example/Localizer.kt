// Where frames were taken, without a class of Android: scripts/phones/run.py compiles and runs this file on a JVM.
package org.veiloc.example

import java.net.HttpURLConnection
import java.net.URL
import java.nio.ByteBuffer
import org.veiloc.Advice
import org.veiloc.Alignment
import org.veiloc.Answer
import org.veiloc.Axes
import org.veiloc.Burst
import org.veiloc.Camera
import org.veiloc.CameraPose
import org.veiloc.ContentAnchors
import org.veiloc.FrameLayout
import org.veiloc.PlacedAnchor
import org.veiloc.Pose
import org.veiloc.Profile
import org.veiloc.SealedBurst
import org.veiloc.Sealer
import org.veiloc.Session
import org.veiloc.Update
import org.veiloc.VeilocException
import org.veiloc.advice
import org.veiloc.adviceText

/** One map of a service. Calls block: use a background thread, except for `offer` and `frames`. */
class Localizer(private val server: String, private val map: String, private val token: String? = null) : AutoCloseable {
    /** What one burst gave. */
    class Result(val answer: Answer?, val update: Update?, val words: String)

    private val sealer = Profile(request(server, map, "profile", token = token).second).use { Sealer(it) }
    private val session = Session()
    private val burst = Burst()
    val alignment = Alignment()
    private var misses = 0u

    /** Takes a frame. `camera`, `pose` and `seconds` are those of the moment at which it was taken. */
    fun offer(pixels: ByteBuffer, layout: FrameLayout, camera: Camera?, pose: CameraPose, seconds: Double) {
        burst.offer(pixels, layout, camera, pose, seconds)
    }

    /** Frames that `locate` would seal: three, once they reach back about a second. */
    fun frames(): Int = burst.frames().toInt()

    /** Seals the sharpest frames of the last second and asks the service. */
    fun locate(): Result {
        val sealed = try {
            burst.seal(sealer, session)
        } catch (unusable: VeilocException) {
            // Nothing was sent: another burst costs nothing.
            return Result(null, null, words(null, null) + " (" + unusable.message + ")")
        }
        sealed.use {
            val (status, body) = request(server, map, "localize-rig", it.bytes(), token)
            if (status != 200) {
                // 422: no pose was found. 429 and 503: the same bytes may be sent again after Retry-After seconds.
                if (status == 422) misses++
                return Result(null, null, words(it, null))
            }
            misses = 0u
            val answer = Answer(body)
            burst.learnUnit(answer)
            // The answer is about the newest frame.
            return Result(answer, alignment.add(answer, it.cameraInWorld(Axes.OPEN_GL)), words(it, answer))
        }
    }

    /** Where content that is placed in the map is in ARCore's world; null before the first trusted answer. */
    fun worldFromAnchor(mapFromAnchor: Pose): Pose? = alignment.worldFromAnchor(Axes.OPEN_GL, mapFromAnchor)

    /** The content anchors of the map in ARCore's world, the nearest first; none before the first trusted answer. */
    fun anchors(camera: CameraPose): List<PlacedAnchor> =
        ContentAnchors(request(server, map, "anchors", token = token).second).use { it.place(alignment, camera) }

    private fun words(sealed: SealedBurst?, answer: Answer?): String = adviceText(advice(sealed?.newest(), answer, misses = misses))

    override fun close() {
        sealer.close()
        session.close()
        burst.close()
        alignment.close()
    }
}

/** Asks for something of a map: status and body. It blocks. */
fun request(server: String, map: String, what: String, body: ByteArray? = null, token: String? = null): Pair<Int, ByteArray> {
    val connection = URL("$server/v1/maps/$map/$what").openConnection() as HttpURLConnection
    connection.setRequestProperty("Accept", "application/x-protobuf")
    token?.let { connection.setRequestProperty("Authorization", "Bearer $it") }
    if (body != null) {
        connection.doOutput = true
        connection.setRequestProperty("Content-Type", "application/x-protobuf")
        connection.outputStream.use { it.write(body) }
    }
    val status = connection.responseCode
    val stream = if (status < 400) connection.inputStream else connection.errorStream
    return Pair(status, stream?.use { it.readBytes() } ?: ByteArray(0))
}

/** Whether the user can be shown the position. */
fun isReady(advice: Advice): Boolean = advice == Advice.READY
