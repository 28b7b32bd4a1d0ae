// The app: a photo is chosen, sealed and localized. Not compiled by this project's checks: it needs the Android SDK.
package org.veiloc.example

import android.app.Activity
import android.content.Intent
import android.graphics.Bitmap
import android.graphics.BitmapFactory
import android.net.Uri
import android.os.Bundle
import android.widget.Button
import android.widget.EditText
import android.widget.LinearLayout
import android.widget.TextView
import java.nio.ByteBuffer
import kotlin.concurrent.thread
import org.veiloc.Answer
import org.veiloc.FrameFormat
import org.veiloc.FrameLayout
import org.veiloc.Profile
import org.veiloc.Sealer

class FirstPose : Activity() {
    private lateinit var server: EditText
    private lateinit var map: EditText
    private lateinit var shown: TextView

    override fun onCreate(state: Bundle?) {
        super.onCreate(state)
        server = EditText(this).apply { setText("http://127.0.0.1:8080") }
        map = EditText(this).apply { setText("lobby") }
        shown = TextView(this)
        val choose = Button(this).apply { text = "Choose a photo" }
        choose.setOnClickListener { startActivityForResult(Intent(Intent.ACTION_GET_CONTENT).setType("image/*"), 1) }
        setContentView(LinearLayout(this).apply {
            orientation = LinearLayout.VERTICAL
            for (view in listOf(server, map, choose, shown)) addView(view)
        })
    }

    override fun onActivityResult(request: Int, result: Int, data: Intent?) {
        val photo = data?.data ?: return
        val (address, name) = Pair(server.text.toString(), map.text.toString())
        shown.text = "…"
        thread {
            val words = try { locate(address, name, photo) } catch (error: Exception) { error.toString() }
            runOnUiThread { shown.text = words }
        }
    }

    /** On a background thread: the JSON of the answer, or of the refusal. */
    private fun locate(server: String, map: String, photo: Uri): String {
        val options = BitmapFactory.Options().apply { inPreferredConfig = Bitmap.Config.ARGB_8888 }
        val bitmap = contentResolver.openInputStream(photo)?.use { BitmapFactory.decodeStream(it, null, options) } ?: return "not an image"
        val pixels = ByteBuffer.allocateDirect(bitmap.rowBytes * bitmap.height)
        bitmap.copyPixelsToBuffer(pixels)
        pixels.rewind()
        val layout = FrameLayout(FrameFormat.RGBA, bitmap.width.toUInt(), bitmap.height.toUInt(), bitmap.rowBytes.toUInt())
        val (found, profile) = request(server, map, "profile")
        if (found != 200) return profile.decodeToString()
        // Without a camera the focal length is estimated. A photo is sealed once: after a network error send the same bytes again.
        val query = Profile(profile).use { Sealer(it) }.use { sealer -> sealer.seal(sealer.extract(pixels, layout)).use { it.bytes() } }
        val (status, body) = request(server, map, "localize", query)
        return if (status == 200) Answer(body).use { it.toJson() } else body.decodeToString()
    }
}
