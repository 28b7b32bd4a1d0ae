// Where frames were taken, without a class of Android: scripts/phones/run.py compiles and runs this file on a JVM.
package org.veiloc.example

import java.net.HttpURLConnection
import java.net.URL
import java.nio.ByteBuffer
import org.veiloc.Advice
import org.veiloc.Alignment
import org.veiloc.Answer
import org.veiloc.Axes
import org.veiloc.Camera
import org.veiloc.CameraPose
import org.veiloc.FrameLayout
import org.veiloc.Pose
import org.veiloc.Profile
import org.veiloc.Query
import org.veiloc.Session
import org.veiloc.Update
import org.veiloc.VeilocException
import org.veiloc.advice
import org.veiloc.adviceText
import org.veiloc.seal

/** One map of a service. Calls block: use a background thread. */
class Localizer(private val server: String, private val map: String, private val token: String? = null) : AutoCloseable {
    /** What one frame gave. */
    class Result(val answer: Answer?, val update: Update?, val words: String)

    private val profile = Profile(request("profile", null).second)
    private val session = Session()
    val alignment = Alignment()
    private var misses = 0u

    /** Seals a frame and asks the service. `camera` and `pose` are those of the moment at which the frame was taken. */
    fun locate(pixels: ByteBuffer, layout: FrameLayout, camera: Camera?, pose: CameraPose): Result {
        val query = try {
            seal(profile, pixels, layout, camera, session, cameraInWorld = pose)
        } catch (unusable: VeilocException) {
            // Nothing was sent: another frame costs nothing.
            return Result(null, null, words(null, null) + " (" + unusable.message + ")")
        }
        query.use {
            val (status, body) = request("localize", it.bytes())
            if (status != 200) {
                // 422: no pose was found. 429 and 503: the same bytes may be sent again after Retry-After seconds.
                if (status == 422) misses++
                return Result(null, null, words(it, null))
            }
            misses = 0u
            val answer = Answer(body)
            return Result(answer, alignment.add(answer, pose), words(it, answer))
        }
    }

    /** Where content that is placed in the map is in ARCore's world; null before the first trusted answer. */
    fun worldFromAnchor(mapFromAnchor: Pose): Pose? = alignment.worldFromAnchor(Axes.OPEN_GL, mapFromAnchor)

    private fun words(query: Query?, answer: Answer?): String = adviceText(advice(query, answer, misses = misses))

    private fun request(what: String, body: ByteArray?): Pair<Int, ByteArray> {
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

    override fun close() {
        profile.close()
        session.close()
        alignment.close()
    }
}

/** Whether the user can be shown the position. */
fun isReady(advice: Advice): Boolean = advice == Advice.READY
