// Frames, intrinsics and poses of AR Foundation. Not compiled by this project's checks: it needs Unity.
#if UNITY_2022_3_OR_NEWER
using System.Threading.Tasks;
using Unity.Collections.LowLevel.Unsafe;
using UnityEngine;
using UnityEngine.Networking;
using UnityEngine.XR.ARFoundation;
using UnityEngine.XR.ARSubsystems;

namespace Veiloc
{
    /// <summary>Localizes a burst of frames after the other, and moves `content`, which is placed at the origin of the map.</summary>
    public class ArFoundationLocalizer : MonoBehaviour
    {
        public string server = "https://places.example:8443";
        public string map = "lobby";
        public ARCameraManager cameraManager;
        public Transform content;
        /// <summary>Clockwise degrees from the sensor's image to the display: 90 for a phone held upright.</summary>
        public int turnDegrees = 90;

        Sealer sealer;
        Session session;
        Burst burst;
        Alignment alignment;
        bool busy;

        async void Start()
        {
            var (status, bytes) = await Request("profile", null);
            if (status != 200) return;
            session = Session.Begin();
            burst = Burst.Begin();
            alignment = Alignment.Begin();
            using (var profile = Profile.Read(bytes)) sealer = Sealer.For(profile);
        }

        async void Update()
        {
            if (sealer == null || ARSession.state != ARSessionState.SessionTracking) return;
            if (!cameraManager.TryGetIntrinsics(out XRCameraIntrinsics k) || !cameraManager.TryAcquireLatestCpuImage(out XRCpuImage image)) return;
            using (image)
            {
                // Of this very frame.
                var at = cameraManager.transform;
                var pose = new Pose(at.position.x, at.position.y, at.position.z, at.rotation.x, at.rotation.y, at.rotation.z, at.rotation.w);
                var camera = Camera.Pinhole((uint)image.width, (uint)image.height, k.focalLength.x, k.focalLength.y, k.principalPoint.x, k.principalPoint.y);
                var gray = image.GetPlane(0);
                var layout = new FrameLayout { Format = PixelFormat.Gray, Width = camera.Width, Height = camera.Height, RowStride = (uint)gray.rowStride, TurnDegrees = turnDegrees };
                System.IntPtr pixels;
                unsafe { pixels = (System.IntPtr)NativeArrayUnsafeUtility.GetUnsafeReadOnlyPtr(gray.data); }
                burst.Offer(pixels, gray.data.Length, layout, camera, pose, image.timestamp);
            }
            if (busy || burst.Frames < 3) return;
            busy = true;
            try
            {
                using (var made = await Task.Run(() => burst.Seal(sealer, session)))
                {
                    var (status, bytes) = await Request("localize-rig", made.Bytes());
                    if (status != 200) return;
                    // The answer is about the newest frame of the burst: the camera has moved on.
                    using (var answer = Answer.Read(bytes))
                    {
                        burst.LearnUnit(answer);
                        alignment.Add(answer, made.CameraInWorld());
                    }
                }
                if (alignment.Info.State == AlignmentState.Searching) return;
                var p = alignment.WorldFromAnchor(new Pose(0, 0, 0, 0, 0, 0, 1));
                content.SetPositionAndRotation(new Vector3((float)p.X, (float)p.Y, (float)p.Z), new Quaternion((float)p.Qx, (float)p.Qy, (float)p.Qz, (float)p.Qw));
            }
            catch (VeilocException unusable) { Debug.Log(unusable.Message); }
            finally { busy = false; }
        }

        async Task<(long, byte[])> Request(string what, byte[] body)
        {
            using (var request = new UnityWebRequest($"{server}/v1/maps/{map}/{what}", body == null ? "GET" : "POST"))
            {
                request.downloadHandler = new DownloadHandlerBuffer();
                request.SetRequestHeader("Accept", "application/x-protobuf");
                if (body != null)
                {
                    request.uploadHandler = new UploadHandlerRaw(body) { contentType = "application/x-protobuf" };
                }
                var operation = request.SendWebRequest();
                while (!operation.isDone) await Task.Yield();
                return (request.responseCode, request.downloadHandler.data);
            }
        }

        void OnDestroy()
        {
            alignment?.Dispose();
            burst?.Dispose();
            session?.Dispose();
            sealer?.Dispose();
        }
    }
}
#endif
