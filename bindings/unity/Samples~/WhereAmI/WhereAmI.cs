// Finds a photograph in the map of a service, and shows where it was taken. Not compiled by this project's checks: it needs Unity.
using System.Collections;
using UnityEngine;
using UnityEngine.Networking;

namespace Veiloc.Samples
{
    public class WhereAmI : MonoBehaviour
    {
        public string server = "http://127.0.0.1:8080";
        public string map = "lobby";
        [Tooltip("In its import settings: Read/Write on, no compression, Non-Power of 2: None")]
        public Texture2D photo;
        string shown = "Give this object a photo of the place, and press Play.";

        IEnumerator Start()
        {
            if (photo == null) yield break;
            var address = server + "/v1/maps/" + map;
            using (var profile = UnityWebRequest.Get(address + "/profile"))
            {
                yield return profile.SendWebRequest();
                if (Failed(profile)) yield break;
                byte[] query;
                try { query = Sealed(profile.downloadHandler.data); }
                catch (VeilocException unusable) { shown = unusable.Message; yield break; }
                // After a network error, send the same bytes again; never seal the photo twice.
                using (var asked = new UnityWebRequest(address + "/localize", "POST", new DownloadHandlerBuffer(), new UploadHandlerRaw(query)))
                {
                    asked.SetRequestHeader("Content-Type", "application/x-protobuf");
                    asked.SetRequestHeader("Accept", "application/x-protobuf");
                    yield return asked.SendWebRequest();
                    if (Failed(asked)) yield break;
                    using (var answer = Answer.Read(asked.downloadHandler.data))
                    {
                        shown = answer.Json();
                        if (!answer.Info.HasPose) yield break;
                        // With 1, positions are in units of the map.
                        var at = answer.CameraInMap(Axes.Unity, answer.Info.MetresPerUnit > 0 ? answer.Info.MetresPerUnit : 1);
                        transform.SetPositionAndRotation(new Vector3((float)at.X, (float)at.Y, (float)at.Z), new Quaternion((float)at.Qx, (float)at.Qy, (float)at.Qz, (float)at.Qw));
                    }
                }
            }
        }

        byte[] Sealed(byte[] profileBytes)
        {
            // Unity's rows begin at the bottom.
            var pixels = photo.GetPixels32();
            int width = photo.width, height = photo.height;
            var rgba = new byte[4 * pixels.Length];
            for (int y = 0, i = 0; y < height; y++)
                for (int x = 0; x < width; x++)
                {
                    var pixel = pixels[(height - 1 - y) * width + x];
                    rgba[i++] = pixel.r; rgba[i++] = pixel.g; rgba[i++] = pixel.b; rgba[i++] = pixel.a;
                }
            var layout = new FrameLayout { Format = PixelFormat.Rgba, Width = (uint)width, Height = (uint)height };
            // Without a camera the focal length is estimated; give it where it is known.
            using (var profile = Profile.Read(profileBytes))
            using (var sealer = Sealer.For(profile))
            using (var extracted = sealer.Extract(rgba, layout))
            using (var query = sealer.Seal(extracted))
                return query.Bytes();
        }

        bool Failed(UnityWebRequest request)
        {
            if (request.result == UnityWebRequest.Result.Success) return false;
            shown = request.error + " " + request.downloadHandler.text;
            return true;
        }

        void OnGUI() { GUI.Label(new Rect(10, 10, Screen.width - 20, Screen.height - 20), shown); }
    }
}
