// Frames, intrinsics and poses of ARCore for Localizer. Not compiled by this project's checks: it needs the Android SDK and ARCore.
package org.veiloc.example

import com.google.ar.core.Frame
import com.google.ar.core.TrackingState
import com.google.ar.core.exceptions.NotYetAvailableException
import java.util.concurrent.Executors
import java.util.concurrent.atomic.AtomicBoolean
import org.veiloc.Axes
import org.veiloc.CameraPose
import org.veiloc.FrameFormat
import org.veiloc.FrameLayout
import org.veiloc.Pose
import org.veiloc.pinholeCamera

/** `localizer` is made on a background thread, because it fetches the profile. `onResult` is called on a background thread. */
class ArCoreLocalizer(private val localizer: Localizer, private val onResult: (Localizer.Result) -> Unit) : AutoCloseable {
    private val thread = Executors.newSingleThreadExecutor()
    private val busy = AtomicBoolean(false)

    /** Takes every frame, and localizes the sharpest of the last second unless some are being localized. */
    fun update(frame: Frame) {
        if (frame.camera.trackingState != TrackingState.TRACKING) return
        val image = try {
            frame.acquireCameraImage()
        } catch (_: NotYetAvailableException) {
            return
        }
        // Of this very frame: the answer comes when the camera has moved on. getPose is that of the sensor's image.
        val p = frame.camera.pose
        val pose = CameraPose(
            Axes.OPEN_GL,
            Pose(p.tx().toDouble(), p.ty().toDouble(), p.tz().toDouble(), p.qx().toDouble(), p.qy().toDouble(), p.qz().toDouble(), p.qw().toDouble()),
        )
        val intrinsics = frame.camera.imageIntrinsics
        val (fx, fy) = intrinsics.focalLength.map { it.toDouble() }
        val (cx, cy) = intrinsics.principalPoint.map { it.toDouble() }
        val camera = pinholeCamera(image.width.toUInt(), image.height.toUInt(), fx, fy, cx, cy)
        val gray = image.planes[0]
        val layout = FrameLayout(FrameFormat.GRAY, camera.width, camera.height, gray.rowStride.toUInt())
        image.use { localizer.offer(gray.buffer, layout, camera, pose, frame.timestamp / 1e9) }
        if (localizer.frames() < 3 || !busy.compareAndSet(false, true)) return
        thread.execute {
            try {
                onResult(localizer.locate())
            } finally {
                busy.set(false)
            }
        }
    }

    override fun close() {
        thread.shutdown()
    }
}
