// The device side of veiloc for C# and Unity: owners of the handles of veiloc.h, and exceptions in place of statuses.
// Nothing here computes: each method is a function of veiloc.h (bindings/c). No class of Unity is used, so the file also
// runs on .NET and mono; scripts/phones/run.py does.
using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;
using System.Text;

namespace Veiloc
{
    /// <summary>What an app does about an error: see veiloc.h.</summary>
    public enum Status { Ok, Argument, Profile, Image, Texture, Unbalanced, Session, TooManyStarts, TurnedAway, Seal, Answer, NotAligned, Internal, Cancelled, Pack, NotThisPlace }

    /// <summary>Axes and units of a framework.</summary>
    public enum Axes : uint { OpenGl, Unity, Unreal, Colmap }

    /// <summary>Bytes of a pixel. Gray is also the first plane of YUV 420.</summary>
    public enum PixelFormat : uint { Gray, Rgba, Bgra }

    public enum Focal : uint { Calibrated, Exif, Unknown }

    /// <summary>What is sent with a pack: the points that keypoints match in it, and no descriptor; or the descriptors that it explains.</summary>
    public enum PackUse : uint { Matches, Explained }

    public enum AlignmentState { Searching, Tentative, Aligned }

    public enum Update { Used, Contradicts, DoubtfulAgrees, Doubtful, NoPose, UnknownUnit }

    public enum Distances { Unknown, Agree, Differ }

    public enum Advice : uint { TooDark, MoveSlower, ShowMoreDetail, ShowBothSides, NotInThisPlace, TurnToMappedPlace, ShowSurroundings, MoveCloser, Ready }

    public class VeilocException : Exception
    {
        public readonly Status Status;

        public VeilocException(Status status, string message) : base(message) { Status = status; }
    }

    /// <summary>A pose as a framework states it. In Unity: transform.position and transform.rotation.</summary>
    [StructLayout(LayoutKind.Sequential)]
    public struct Pose
    {
        public double X, Y, Z, Qx, Qy, Qz, Qw;

        public Pose(double x, double y, double z, double qx, double qy, double qz, double qw)
        {
            X = x; Y = y; Z = z; Qx = qx; Qy = qy; Qz = qz; Qw = qw;
        }

        /// <summary>The pose in the world of what has the pose `mounted` in the axes of this object: of a headset's camera, from the pose of
        /// the head and the lens offset.</summary>
        public Pose Composed(Pose mounted)
        {
            Pose pose;
            Native.Check(Native.veiloc_pose_composed(ref this, ref mounted, out pose));
            return pose;
        }
    }

    /// <summary>Radii of 68 % confidence, metres and degrees.</summary>
    [StructLayout(LayoutKind.Sequential)]
    public struct Accuracy { public double Horizontal, Vertical, YawDeg; }

    /// <summary>A camera of COLMAP's models, of the frame as the sensor gives it.</summary>
    public class Camera
    {
        public string Model = "PINHOLE";
        public uint Width, Height;
        public double[] Params = new double[0];
        public Focal Focal = Focal.Calibrated;

        /// <summary>From XRCameraIntrinsics: focalLength, principalPoint and resolution.</summary>
        public static Camera Pinhole(uint width, uint height, double fx, double fy, double cx, double cy)
        {
            return new Camera { Width = width, Height = height, Params = new[] { fx, fy, cx, cy } };
        }

        /// <summary>The camera of a part of the image: for passthrough cameras of headsets, whose smaller images are parts of the
        /// sensor's.</summary>
        public Camera Cropped(uint x, uint y, uint width, uint height)
        {
            Native.Camera part;
            using (var input = new Native.Input(IntPtr.Zero, 0, new FrameLayout(), this))
            {
                Native.Check(Native.veiloc_camera_cropped(input.Camera, x, y, width, height, out part));
            }
            var cropped = new Camera { Model = Model, Width = width, Height = height, Focal = Focal, Params = new double[Params.Length] };
            Array.Copy(part.Params, cropped.Params, Params.Length);
            return cropped;
        }
    }

    /// <summary>Which values of a mask hide a pixel.</summary>
    public enum MaskKind : uint
    {
        /// <summary>All but 0: a stencil that marks people, as AROcclusionManager's.</summary>
        Marked = 0,
        /// <summary>51 and more: a confidence, 255 for certain.</summary>
        Confidence = 1,
        /// <summary>Person (10) and vehicle (9) of ARCore's scene semantics.</summary>
        ArcoreSemantics = 2,
        /// <summary>Below 128: black hides.</summary>
        DarkHides = 3,
    }

    /// <summary>Pixels of a frame of which nothing is sent: a byte for each, of any resolution. It shows the same as the frame, before the
    /// frame is turned.</summary>
    public sealed class Mask
    {
        public MaskKind Kind;
        public uint Width, Height;
        public byte[] Bytes;
        /// <summary>Bytes from one row to the next; 0 when rows follow each other.</summary>
        public uint RowStride;
        /// <summary>How far beyond what is marked is hidden, too, as a share of the longer side; 0 for 0.02.</summary>
        public float Margin;
    }

    /// <summary>How the bytes of a frame are arranged.</summary>
    public struct FrameLayout
    {
        public PixelFormat Format;
        public uint Width, Height;
        /// <summary>Bytes from one row to the next; 0 when rows follow each other.</summary>
        public uint RowStride;
        /// <summary>Clockwise degrees that turn the frame upright. AR Foundation's camera is that of the upright frame.</summary>
        public int TurnDegrees;
        /// <summary>People and what else must not be sent; null for none.</summary>
        public Mask Mask;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct QueryInfo
    {
        public uint Rows, Keypoints;
        public double Brightness;
        internal uint StepCount;
        [MarshalAs(UnmanagedType.ByValArray, SizeConst = 8)] internal uint[] AllSteps;

        /// <summary>Rows of each step of progressive localization.</summary>
        public uint[] Steps
        {
            get
            {
                var steps = new uint[StepCount];
                Array.Copy(AllSteps, steps, (int)StepCount);
                return steps;
            }
        }
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct AnswerInfo
    {
        [MarshalAs(UnmanagedType.U1)] public bool HasPose;
        [MarshalAs(UnmanagedType.U1)] public bool Trusted;
        public double PositionSd, MetresPerUnit;
        /// <summary>Direction of gravity in the map; zeros when the map does not know it.</summary>
        public double DownX, DownY, DownZ;
        public uint Inliers, Matches, Doubts;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct AlignmentInfo
    {
        public AlignmentState State;
        public uint Used, Contradicting;
        public Distances Distances;
        public double DistanceRatio;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct SessionInfo { public uint Frames, Starts; }

    /// <summary>Which frames a burst keeps, and how exact their poses are: see veiloc.h. Zero is the default of each.</summary>
    [StructLayout(LayoutKind.Sequential)]
    public struct BurstOptions
    {
        public uint Frames;
        /// <summary>Seconds.</summary>
        public double Window;
        public double RotationSdDeg, TranslationSd, MetresPerUnit;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct SealedBurstInfo
    {
        public uint Frames, LeftOut;
        /// <summary>The newest frame that was sealed. It has no steps.</summary>
        public QueryInfo Newest;
    }

    internal static class Native
    {
#if UNITY_IOS && !UNITY_EDITOR
        const string Library = "__Internal";
#else
        const string Library = "veiloc_c";
#endif

        [StructLayout(LayoutKind.Sequential)]
        internal struct Bytes { internal IntPtr Data; internal UIntPtr Length; }

        [StructLayout(LayoutKind.Sequential)]
        internal struct Frame
        {
            internal IntPtr Bytes;
            internal UIntPtr Length;
            internal uint Format, Width, Height;
            internal UIntPtr RowStride;
            internal int TurnDegrees;
            internal IntPtr Mask;
        }

        [StructLayout(LayoutKind.Sequential)]
        internal struct NativeMask
        {
            internal IntPtr Bytes;
            internal UIntPtr Length;
            internal uint Kind, Width, Height;
            internal UIntPtr RowStride;
            internal float Margin;
        }

        [StructLayout(LayoutKind.Sequential)]
        internal struct Camera
        {
            internal IntPtr Model;
            internal uint Width, Height;
            [MarshalAs(UnmanagedType.ByValArray, SizeConst = 16)] internal double[] Params;
            internal uint ParamCount, Focal;
        }

        [StructLayout(LayoutKind.Sequential)]
        internal struct Options
        {
            internal IntPtr Scheme;
            internal uint MaxKeypoints, MaxImageSide, AngleBits;
            [MarshalAs(UnmanagedType.U1)] internal bool WithoutGravity;
            internal IntPtr Pack;
            internal uint Send;
        }

        [DllImport(Library)] internal static extern IntPtr veiloc_last_error();
        [DllImport(Library)] internal static extern IntPtr veiloc_version();
        [DllImport(Library)] internal static extern void veiloc_bytes_free(Bytes bytes);
        [DllImport(Library)] internal static extern Status veiloc_camera_cropped(IntPtr camera, uint x, uint y, uint width, uint height, out Camera part);
        [DllImport(Library)] internal static extern Status veiloc_pose_composed(ref Pose pose, ref Pose mounted, out Pose composed);
        [DllImport(Library)] internal static extern Status veiloc_profile_new(byte[] bytes, UIntPtr length, out IntPtr handle);
        [DllImport(Library)] internal static extern IntPtr veiloc_profile_id(IntPtr profile);
        [DllImport(Library)] internal static extern void veiloc_profile_free(IntPtr profile);
        [DllImport(Library)] internal static extern Status veiloc_pack_new(byte[] bytes, UIntPtr length, out IntPtr handle);
        [DllImport(Library)] internal static extern IntPtr veiloc_pack_id(IntPtr pack);
        [DllImport(Library)] internal static extern Status veiloc_pack_profile(IntPtr pack, out IntPtr handle);
        [DllImport(Library)] internal static extern void veiloc_pack_free(IntPtr pack);
        [DllImport(Library)] internal static extern Status veiloc_session_new(byte[] anchors, out IntPtr handle);
        [DllImport(Library)] internal static extern Status veiloc_session_from_bytes(byte[] bytes, UIntPtr length, out IntPtr handle);
        [DllImport(Library)] internal static extern Status veiloc_session_to_bytes(IntPtr session, out Bytes bytes);
        [DllImport(Library)] internal static extern SessionInfo veiloc_session_info(IntPtr session);
        [DllImport(Library)] internal static extern void veiloc_session_free(IntPtr session);
        [DllImport(Library)] internal static extern Status veiloc_sealer_new(IntPtr profile, ref Options options, out IntPtr handle);
        [DllImport(Library)] internal static extern Status veiloc_sealer_extract(IntPtr sealer, ref Frame frame, IntPtr camera, uint axes, IntPtr pose, IntPtr cancellation, out IntPtr handle);
        [DllImport(Library)] internal static extern Status veiloc_sealer_seal(IntPtr sealer, IntPtr session, IntPtr extracted, out IntPtr handle);
#if VEILOC_SEEDED
        [DllImport(Library)] internal static extern Status veiloc_sealer_seal_seeded(IntPtr sealer, IntPtr session, IntPtr extracted, byte[] seed, out IntPtr handle);
#endif
        [DllImport(Library)] internal static extern void veiloc_sealer_free(IntPtr sealer);
        [DllImport(Library)] internal static extern void veiloc_extracted_free(IntPtr extracted);
        [DllImport(Library)] internal static extern Status veiloc_cancellation_new(out IntPtr handle);
        [DllImport(Library)] internal static extern void veiloc_cancel(IntPtr cancellation);
        [DllImport(Library)] internal static extern void veiloc_cancellation_free(IntPtr cancellation);
        [DllImport(Library)] internal static extern QueryInfo veiloc_query_info(IntPtr query);
        [DllImport(Library)] internal static extern Status veiloc_query_bytes(IntPtr query, uint rows, out Bytes bytes);
        [DllImport(Library)] internal static extern void veiloc_query_free(IntPtr query);
        [DllImport(Library)] internal static extern Status veiloc_burst_new(ref BurstOptions options, out IntPtr handle);
        [DllImport(Library)] internal static extern Status veiloc_burst_learn_unit(IntPtr burst, IntPtr answer);
        [DllImport(Library)] internal static extern Status veiloc_burst_offer(IntPtr burst, ref Frame frame, IntPtr camera, uint axes, ref Pose pose, double timestamp);
        [DllImport(Library)] internal static extern uint veiloc_burst_frames(IntPtr burst);
        [DllImport(Library)] internal static extern void veiloc_burst_clear(IntPtr burst);
        [DllImport(Library)] internal static extern Status veiloc_burst_seal(IntPtr burst, IntPtr sealer, IntPtr session, IntPtr cancellation, out IntPtr handle);
        [DllImport(Library)] internal static extern void veiloc_burst_free(IntPtr burst);
        [DllImport(Library)] internal static extern Status veiloc_sealed_burst_bytes(IntPtr sealedBurst, out Bytes bytes);
        [DllImport(Library)] internal static extern Status veiloc_sealed_burst_camera_in_world(IntPtr sealedBurst, uint axes, out Pose pose);
        [DllImport(Library)] internal static extern SealedBurstInfo veiloc_sealed_burst_info(IntPtr sealedBurst);
        [DllImport(Library)] internal static extern void veiloc_sealed_burst_free(IntPtr sealedBurst);
        [DllImport(Library)] internal static extern Status veiloc_answer_new(byte[] bytes, UIntPtr length, out IntPtr handle);
        [DllImport(Library)] internal static extern AnswerInfo veiloc_answer_info(IntPtr answer);
        [DllImport(Library)] internal static extern Status veiloc_answer_json(IntPtr answer, out Bytes bytes);
        [DllImport(Library)] internal static extern Status veiloc_answer_camera_in_map(IntPtr answer, uint axes, double metresPerUnit, out Pose pose);
        [DllImport(Library)] internal static extern Status veiloc_answer_accuracy(IntPtr answer, uint axes, ref Pose camera, double metresPerUnit, out Accuracy accuracy);
        [DllImport(Library)] internal static extern void veiloc_answer_free(IntPtr answer);
        [DllImport(Library)] internal static extern Status veiloc_alignment_new(double metresPerUnit, out IntPtr handle);
        [DllImport(Library)] internal static extern Status veiloc_alignment_add(IntPtr alignment, IntPtr answer, uint axes, ref Pose camera, out Update update);
        [DllImport(Library)] internal static extern Status veiloc_alignment_moved(IntPtr alignment, uint axes, ref Pose camera);
        [DllImport(Library)] internal static extern AlignmentInfo veiloc_alignment_info(IntPtr alignment);
        [DllImport(Library)] internal static extern Status veiloc_alignment_world_from_anchor(IntPtr alignment, uint axes, ref Pose anchor, out Pose pose);
        [DllImport(Library)] internal static extern void veiloc_alignment_reset(IntPtr alignment);
        [DllImport(Library)] internal static extern void veiloc_alignment_free(IntPtr alignment);
        [DllImport(Library)] internal static extern Status veiloc_anchors_new(byte[] bytes, UIntPtr length, out IntPtr handle);
        [DllImport(Library)] internal static extern Status veiloc_anchors_place(IntPtr anchors, IntPtr alignment, uint axes, ref Pose camera, out UIntPtr count);
        [DllImport(Library)] internal static extern Status veiloc_anchors_get(IntPtr anchors, UIntPtr index, out Placed placed);
        [DllImport(Library)] internal static extern void veiloc_anchors_free(IntPtr anchors);
        [DllImport(Library)] internal static extern Advice veiloc_advice(ref QueryInfo query, IntPtr answer, double degreesPerSecond, uint misses);
        [DllImport(Library)] internal static extern Advice veiloc_advice(IntPtr query, IntPtr answer, double degreesPerSecond, uint misses);
        [DllImport(Library)] internal static extern IntPtr veiloc_advice_text(Advice advice);

        [StructLayout(LayoutKind.Sequential)]
        internal struct Placed
        {
            internal IntPtr Name, Content;
            internal Pose WorldFromAnchor;
            internal double Distance;
        }

        internal static void Check(Status status)
        {
            if (status != Status.Ok) throw new VeilocException(status, Text(veiloc_last_error()));
        }

        /// <summary>A text of the library, which is UTF-8.</summary>
        internal static string Text(IntPtr text)
        {
            if (text == IntPtr.Zero) return "";
            var bytes = new List<byte>();
            for (int i = 0; Marshal.ReadByte(text, i) != 0; i++) bytes.Add(Marshal.ReadByte(text, i));
            return Encoding.UTF8.GetString(bytes.ToArray());
        }

        internal static byte[] Taken(Bytes bytes)
        {
            var copy = new byte[(int)bytes.Length];
            if (copy.Length > 0) Marshal.Copy(bytes.Data, copy, 0, copy.Length);
            veiloc_bytes_free(bytes);
            return copy;
        }

        internal static byte[] Utf8(string text) { return Encoding.UTF8.GetBytes(text + "\0"); }

        internal static IntPtr ValueOf(Handle handle) { return handle == null ? IntPtr.Zero : handle.Value; }

        /// <summary>A frame and its camera in memory of the library's layout.</summary>
        internal sealed class Input : IDisposable
        {
            internal Frame Frame;
            internal IntPtr Camera = IntPtr.Zero;
            GCHandle model, mask;

            internal Input(IntPtr pixels, long length, FrameLayout layout, Veiloc.Camera camera)
            {
                Frame = new Frame
                {
                    Bytes = pixels, Length = (UIntPtr)(ulong)length, Format = (uint)layout.Format, Width = layout.Width, Height = layout.Height,
                    RowStride = (UIntPtr)layout.RowStride, TurnDegrees = layout.TurnDegrees,
                };
                if (layout.Mask != null)
                {
                    var given = layout.Mask;
                    mask = GCHandle.Alloc(given.Bytes, GCHandleType.Pinned);
                    var hides = new NativeMask
                    {
                        Bytes = mask.AddrOfPinnedObject(), Length = (UIntPtr)(ulong)given.Bytes.Length, Kind = (uint)given.Kind, Width = given.Width,
                        Height = given.Height, RowStride = (UIntPtr)given.RowStride, Margin = given.Margin,
                    };
                    Frame.Mask = Marshal.AllocHGlobal(Marshal.SizeOf(typeof(NativeMask)));
                    Marshal.StructureToPtr(hides, Frame.Mask, false);
                }
                if (camera == null) return;
                model = GCHandle.Alloc(Utf8(camera.Model), GCHandleType.Pinned);
                var native = new Camera
                {
                    Model = model.AddrOfPinnedObject(), Width = camera.Width, Height = camera.Height, Params = new double[16],
                    ParamCount = (uint)camera.Params.Length, Focal = (uint)camera.Focal,
                };
                Array.Copy(camera.Params, native.Params, Math.Min(16, camera.Params.Length));
                this.Camera = Marshal.AllocHGlobal(Marshal.SizeOf(typeof(Camera)));
                Marshal.StructureToPtr(native, this.Camera, false);
            }

            public void Dispose()
            {
                Marshal.FreeHGlobal(Camera);
                Marshal.FreeHGlobal(Frame.Mask);
                if (model.IsAllocated) model.Free();
                if (mask.IsAllocated) mask.Free();
            }
        }
    }

    /// <summary>The owner of a handle: freed by Dispose, or by the garbage collector.</summary>
    public abstract class Handle : IDisposable
    {
        IntPtr value;

        internal Handle(IntPtr value) { this.value = value; }

        internal IntPtr Value
        {
            get
            {
                if (value == IntPtr.Zero) throw new ObjectDisposedException(GetType().Name);
                return value;
            }
        }

        internal abstract void Free(IntPtr handle);

        public void Dispose()
        {
            if (value != IntPtr.Zero) Free(value);
            value = IntPtr.Zero;
            GC.SuppressFinalize(this);
        }

        ~Handle()
        {
            if (value != IntPtr.Zero) Free(value);
        }
    }

    /// <summary>What a device needs to seal for a map: GET /v1/maps/{map}/profile.</summary>
    public class Profile : Handle
    {
        internal Profile(IntPtr handle) : base(handle) { }

        public static Profile Read(byte[] bytes)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_profile_new(bytes, (UIntPtr)bytes.Length, out handle));
            return new Profile(handle);
        }

        public string Id { get { return Native.Text(Native.veiloc_profile_id(Value)); } }

        internal override void Free(IntPtr handle) { Native.veiloc_profile_free(handle); }
    }

    /// <summary>What a place looks like, without where: GET /v1/maps/{map}/pack. With it a sealer sends only what the place knows.</summary>
    public class Pack : Handle
    {
        Pack(IntPtr handle) : base(handle) { }

        /// <summary>Prepares the pack, which takes about a millisecond per thousand rows: call it on a thread of its own, once. Several
        /// sealers may share it.</summary>
        public static Pack Read(byte[] bytes)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_pack_new(bytes, (UIntPtr)bytes.Length, out handle));
            return new Pack(handle);
        }

        public string Id { get { return Native.Text(Native.veiloc_pack_id(Value)); } }

        /// <summary>The profile of the map, which a pack contains.</summary>
        public Profile ToProfile()
        {
            IntPtr handle;
            Native.Check(Native.veiloc_pack_profile(Value, out handle));
            GC.KeepAlive(this);
            return new Profile(handle);
        }

        internal override void Free(IntPtr handle) { Native.veiloc_pack_free(handle); }
    }

    /// <summary>Frames of one place.</summary>
    public class Session : Handle
    {
        Session(IntPtr handle) : base(handle) { }

        public static Session Begin(string anchors = "world")
        {
            IntPtr handle;
            Native.Check(Native.veiloc_session_new(Native.Utf8(anchors), out handle));
            return new Session(handle);
        }

        public static Session Read(byte[] bytes)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_session_from_bytes(bytes, (UIntPtr)bytes.Length, out handle));
            return new Session(handle);
        }

        /// <summary>Keep them in the app's private storage, and never send them: they hold positions of keypoints.</summary>
        public byte[] ToBytes()
        {
            Native.Bytes bytes;
            Native.Check(Native.veiloc_session_to_bytes(Value, out bytes));
            return Native.Taken(bytes);
        }

        public SessionInfo Info { get { return Native.veiloc_session_info(Value); } }

        internal override void Free(IntPtr handle) { Native.veiloc_session_free(handle); }
    }

    /// <summary>A request to stop a call to Sealer.Extract or Burst.Seal. From a CancellationToken: token.Register(cancellation.Cancel).</summary>
    public class Cancellation : Handle
    {
        Cancellation(IntPtr handle) : base(handle) { }

        public static Cancellation Begin()
        {
            IntPtr handle;
            Native.Check(Native.veiloc_cancellation_new(out handle));
            return new Cancellation(handle);
        }

        /// <summary>From any thread. Calls that were given the request, running and later ones, throw Cancelled, and sessions have not
        /// changed. It cannot be revoked.</summary>
        public void Cancel()
        {
            Native.veiloc_cancel(Value);
            GC.KeepAlive(this);
        }

        internal override void Free(IntPtr handle) { Native.veiloc_cancellation_free(handle); }
    }

    /// <summary>Seals frames for one map. Several threads may use it at once.</summary>
    public class Sealer : Handle
    {
        Sealer(IntPtr handle) : base(handle) { }

        /// <summary>Checks what the profile asks for.</summary>
        /// <param name="sendGravity">Whether the direction of gravity is sent, rounded to about a degree, where the pose is known.</param>
        /// <param name="pack">The pack of the map: nothing is sent that the place does not know, and Seal throws NotThisPlace for a frame
        /// of another place. Null: all descriptors are sent.</param>
        /// <param name="send">What is sent with a pack.</param>
        public static Sealer For(Profile profile, bool sendGravity = true, Pack pack = null, PackUse send = PackUse.Matches)
        {
            IntPtr handle;
            var options = new Native.Options { WithoutGravity = !sendGravity, Pack = Native.ValueOf(pack), Send = (uint)send };
            Native.Check(Native.veiloc_sealer_new(profile.Value, ref options, out handle));
            GC.KeepAlive(profile);
            GC.KeepAlive(pack);
            return new Sealer(handle);
        }

        /// <summary>Extracts the features of a frame. Call it on a thread of its own: it takes tens of milliseconds.</summary>
        /// <param name="pixels">The first byte; in Unity NativeArrayUnsafeUtility.GetUnsafeReadOnlyPtr of XRCpuImage.GetPlane(0).data.</param>
        /// <param name="camera">Null for a guessed focal length.</param>
        /// <param name="pose">The pose of the camera when it took the frame. It stays on the device, except for gravity.</param>
        /// <param name="cancellation">Null for a call that is not stopped.</param>
        public Extracted Extract(IntPtr pixels, long length, FrameLayout layout, Camera camera = null, Axes axes = Axes.Unity, Pose? pose = null, Cancellation cancellation = null)
        {
            IntPtr handle, poseAt = IntPtr.Zero;
            try
            {
                if (pose.HasValue)
                {
                    poseAt = Marshal.AllocHGlobal(Marshal.SizeOf(typeof(Pose)));
                    Marshal.StructureToPtr(pose.Value, poseAt, false);
                }
                using (var input = new Native.Input(pixels, length, layout, camera))
                    Native.Check(Native.veiloc_sealer_extract(Value, ref input.Frame, input.Camera, (uint)axes, poseAt, Native.ValueOf(cancellation), out handle));
                return new Extracted(handle);
            }
            finally
            {
                Marshal.FreeHGlobal(poseAt);
                GC.KeepAlive(this);
                GC.KeepAlive(cancellation);
            }
        }

        /// <summary>As above, for bytes of C#.</summary>
        public Extracted Extract(byte[] pixels, FrameLayout layout, Camera camera = null, Axes axes = Axes.Unity, Pose? pose = null, Cancellation cancellation = null)
        {
            var pinned = GCHandle.Alloc(pixels, GCHandleType.Pinned);
            try { return Extract(pinned.AddrOfPinnedObject(), pixels.Length, layout, camera, axes, pose, cancellation); }
            finally { pinned.Free(); }
        }

        /// <summary>Seals the features of a frame, once: they are used up then.</summary>
        /// <param name="session">Null for a frame of its own. Frames of one place belong to one session.</param>
        public Query Seal(Extracted extracted, Session session = null)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_sealer_seal(Value, Native.ValueOf(session), extracted.Value, out handle));
            GC.KeepAlive(this);
            GC.KeepAlive(session);
            GC.KeepAlive(extracted);
            return new Query(handle);
        }

#if VEILOC_SEEDED
        /// <summary>With 32 bytes of randomness, for tests that compare queries.</summary>
        public Query SealSeeded(Extracted extracted, byte[] seed)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_sealer_seal_seeded(Value, IntPtr.Zero, extracted.Value, seed, out handle));
            GC.KeepAlive(this);
            GC.KeepAlive(extracted);
            return new Query(handle);
        }
#endif

        internal override void Free(IntPtr handle) { Native.veiloc_sealer_free(handle); }
    }

    /// <summary>The features of a frame, until they are sealed. They hold positions of keypoints, and are never sent.</summary>
    public class Extracted : Handle
    {
        internal Extracted(IntPtr handle) : base(handle) { }

        internal override void Free(IntPtr handle) { Native.veiloc_extracted_free(handle); }
    }

    /// <summary>A sealed query.</summary>
    public class Query : Handle
    {
        internal Query(IntPtr handle) : base(handle) { }

        public QueryInfo Info { get { return Native.veiloc_query_info(Value); } }

        /// <summary>The bytes for POST /v1/maps/{map}/localize: all that leaves the device. 0 for all rows, or a step.</summary>
        public byte[] Bytes(uint rows = 0)
        {
            Native.Bytes bytes;
            Native.Check(Native.veiloc_query_bytes(Value, rows, out bytes));
            return Native.Taken(bytes);
        }

        internal override void Free(IntPtr handle) { Native.veiloc_query_free(handle); }
    }

    /// <summary>The sharpest frames of the last second. One thread may offer frames while another seals.</summary>
    public class Burst : Handle
    {
        Burst(IntPtr handle) : base(handle) { }

        public static Burst Begin(BurstOptions options = default(BurstOptions))
        {
            IntPtr handle;
            Native.Check(Native.veiloc_burst_new(ref options, out handle));
            return new Burst(handle);
        }

        /// <summary>Takes the unit of the map from an answer, unless the options gave one. Until it is known, one frame is sealed at a time.
        /// Call it with every answer.</summary>
        public void LearnUnit(Answer answer)
        {
            Native.Check(Native.veiloc_burst_learn_unit(Value, answer.Value));
            GC.KeepAlive(this);
            GC.KeepAlive(answer);
        }

        /// <summary>Takes a frame of the camera if it is the sharpest of its part of the window so far: a copy of its gray bytes. Offer every
        /// frame while the AR framework tracks the camera.</summary>
        /// <param name="pose">The pose of the camera when it took the frame.</param>
        /// <param name="timestamp">Seconds of any clock that does not jump; in AR Foundation XRCpuImage.timestamp.</param>
        public void Offer(IntPtr pixels, long length, FrameLayout layout, Camera camera, Pose pose, double timestamp, Axes axes = Axes.Unity)
        {
            using (var input = new Native.Input(pixels, length, layout, camera))
                Native.Check(Native.veiloc_burst_offer(Value, ref input.Frame, input.Camera, (uint)axes, ref pose, timestamp));
            GC.KeepAlive(this);
        }

        /// <summary>As above, for bytes of C#.</summary>
        public void Offer(byte[] pixels, FrameLayout layout, Camera camera, Pose pose, double timestamp, Axes axes = Axes.Unity)
        {
            var pinned = GCHandle.Alloc(pixels, GCHandleType.Pinned);
            try { Offer(pinned.AddrOfPinnedObject(), pixels.Length, layout, camera, pose, timestamp, axes); }
            finally { pinned.Free(); }
        }

        /// <summary>Frames that Seal would seal.</summary>
        public int Frames { get { return (int)Native.veiloc_burst_frames(Value); } }

        /// <summary>Drops the frames: for a new AR session, or when the framework says that it lost its world.</summary>
        public void Clear() { Native.veiloc_burst_clear(Value); }

        /// <summary>Seals the frames in the session of their place, and forgets them. A frame that cannot be sealed is left out; when none
        /// can, the session has not changed. Call it on a thread of its own.</summary>
        public SealedBurst Seal(Sealer sealer, Session session, Cancellation cancellation = null)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_burst_seal(Value, sealer.Value, session.Value, Native.ValueOf(cancellation), out handle));
            GC.KeepAlive(this);
            GC.KeepAlive(sealer);
            GC.KeepAlive(session);
            GC.KeepAlive(cancellation);
            return new SealedBurst(handle);
        }

        internal override void Free(IntPtr handle) { Native.veiloc_burst_free(handle); }
    }

    /// <summary>A burst that was sealed.</summary>
    public class SealedBurst : Handle
    {
        internal SealedBurst(IntPtr handle) : base(handle) { }

        public SealedBurstInfo Info { get { return Native.veiloc_sealed_burst_info(Value); } }

        /// <summary>The bytes for POST /v1/maps/{map}/localize-rig: all that leaves the device. After a network error, send them again.</summary>
        public byte[] Bytes()
        {
            Native.Bytes bytes;
            Native.Check(Native.veiloc_sealed_burst_bytes(Value, out bytes));
            return Native.Taken(bytes);
        }

        /// <summary>The pose of the camera when it took the newest frame: with the answer, for Alignment.Add.</summary>
        public Pose CameraInWorld(Axes axes = Axes.Unity)
        {
            Pose pose;
            Native.Check(Native.veiloc_sealed_burst_camera_in_world(Value, (uint)axes, out pose));
            return pose;
        }

        internal override void Free(IntPtr handle) { Native.veiloc_sealed_burst_free(handle); }
    }

    /// <summary>An answer: the body of status 200 to a request with Accept: application/x-protobuf.</summary>
    public class Answer : Handle
    {
        Answer(IntPtr handle) : base(handle) { }

        public static Answer Read(byte[] bytes)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_answer_new(bytes, (UIntPtr)bytes.Length, out handle));
            return new Answer(handle);
        }

        public AnswerInfo Info { get { return Native.veiloc_answer_info(Value); } }

        /// <summary>The document that the service gives for Accept: application/json.</summary>
        public string Json()
        {
            Native.Bytes bytes;
            Native.Check(Native.veiloc_answer_json(Value, out bytes));
            return Encoding.UTF8.GetString(Native.Taken(bytes));
        }

        /// <summary>Where the camera is in the map, for apps that draw the map.</summary>
        /// <param name="metresPerUnit">0 for the unit that the answer states.</param>
        public Pose CameraInMap(Axes axes = Axes.Unity, double metresPerUnit = 0)
        {
            Pose pose;
            Native.Check(Native.veiloc_answer_camera_in_map(Value, (uint)axes, metresPerUnit, out pose));
            return pose;
        }

        public Accuracy Accuracy(Pose camera, Axes axes = Axes.Unity, double metresPerUnit = 0)
        {
            Accuracy accuracy;
            Native.Check(Native.veiloc_answer_accuracy(Value, (uint)axes, ref camera, metresPerUnit, out accuracy));
            return accuracy;
        }

        internal override void Free(IntPtr handle) { Native.veiloc_answer_free(handle); }
    }

    /// <summary>The transform from the map to the AR world, from several answers.</summary>
    public class Alignment : Handle
    {
        Alignment(IntPtr handle) : base(handle) { }

        /// <param name="metresPerUnit">0 for the unit that the answers state.</param>
        public static Alignment Begin(double metresPerUnit = 0)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_alignment_new(metresPerUnit, out handle));
            return new Alignment(handle);
        }

        /// <param name="camera">The pose of the camera when it took the frame that was sealed, not its pose now.</param>
        public Update Add(Answer answer, Pose camera, Axes axes = Axes.Unity)
        {
            Update update;
            Native.Check(Native.veiloc_alignment_add(Value, answer.Value, (uint)axes, ref camera, out update));
            return update;
        }

        public void Moved(Pose camera, Axes axes = Axes.Unity)
        {
            Native.Check(Native.veiloc_alignment_moved(Value, (uint)axes, ref camera));
        }

        public AlignmentInfo Info { get { return Native.veiloc_alignment_info(Value); } }

        /// <summary>Where content that is placed in the map is in the AR world. Throws NotAligned before the first trusted answer.</summary>
        public Pose WorldFromAnchor(Pose mapFromAnchor, Axes axes = Axes.Unity)
        {
            Pose pose;
            Native.Check(Native.veiloc_alignment_world_from_anchor(Value, (uint)axes, ref mapFromAnchor, out pose));
            return pose;
        }

        public void Reset() { Native.veiloc_alignment_reset(Value); }

        internal override void Free(IntPtr handle) { Native.veiloc_alignment_free(handle); }
    }

    /// <summary>A content anchor in the AR world.</summary>
    public struct PlacedAnchor
    {
        public string Name;
        /// <summary>JSON.</summary>
        public string Content;
        public Pose WorldFromAnchor;
        /// <summary>From the camera, metres.</summary>
        public double Distance;
    }

    /// <summary>The content anchors of a map: the body of GET /v1/maps/{map}/anchors.</summary>
    public class Anchors : Handle
    {
        Anchors(IntPtr handle) : base(handle) { }

        public static Anchors Read(byte[] bytes)
        {
            IntPtr handle;
            Native.Check(Native.veiloc_anchors_new(bytes, (UIntPtr)bytes.Length, out handle));
            return new Anchors(handle);
        }

        /// <summary>All in the AR world, the nearest first; none before the first trusted answer.</summary>
        public PlacedAnchor[] Place(Alignment alignment, Pose camera, Axes axes = Axes.Unity)
        {
            UIntPtr count;
            Native.Check(Native.veiloc_anchors_place(Value, alignment.Value, (uint)axes, ref camera, out count));
            var all = new PlacedAnchor[(int)count];
            for (var i = 0; i < all.Length; i++)
            {
                Native.Placed one;
                Native.Check(Native.veiloc_anchors_get(Value, (UIntPtr)i, out one));
                all[i] = new PlacedAnchor { Name = Native.Text(one.Name), Content = Native.Text(one.Content), WorldFromAnchor = one.WorldFromAnchor, Distance = one.Distance };
            }
            GC.KeepAlive(this);
            GC.KeepAlive(alignment);
            return all;
        }

        internal override void Free(IntPtr handle) { Native.veiloc_anchors_free(handle); }
    }

    public static class Library
    {
        public static string Version { get { return Native.Text(Native.veiloc_version()); } }

        /// <summary>What the user should do, by Query.Info or SealedBurstInfo.Newest. Null for a frame that was not sealed, or not
        /// answered.</summary>
        public static Advice AdviceFor(QueryInfo? query, Answer answer, double degreesPerSecond = 0, uint misses = 0)
        {
            var answerAt = answer == null ? IntPtr.Zero : answer.Value;
            if (query == null) return Native.veiloc_advice(IntPtr.Zero, answerAt, degreesPerSecond, misses);
            var info = query.Value;
            return Native.veiloc_advice(ref info, answerAt, degreesPerSecond, misses);
        }

        /// <summary>A sentence for the user, in English.</summary>
        public static string Text(Advice advice) { return Native.Text(Native.veiloc_advice_text(advice)); }
    }
}
