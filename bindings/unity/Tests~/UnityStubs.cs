// The names of Unity, AR Foundation and NUnit that this package uses, so that mono finds mistakes in the rest of it. Written by hand
// from Unity's documentation, and never run: whether Unity agrees, only Unity can say.
using System;

namespace UnityEngine
{
    public struct Vector2 { public float x, y; }
    public struct Vector2Int { public int x, y; }
    public struct Vector3 { public float x, y, z; public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; } }
    public struct Quaternion { public float x, y, z, w; public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; } }
    public struct Color32 { public byte r, g, b, a; }
    public struct Rect { public Rect(float x, float y, float width, float height) { } }
    public class Object { }
    public class GameObject : Object { public GameObject(string name, params Type[] components) { } }
    public class Transform { public Vector3 position; public Quaternion rotation; public void SetPositionAndRotation(Vector3 at, Quaternion turn) { } }
    public class MonoBehaviour : Object { public Transform transform; }
    public class Texture2D : Object { public int width, height; public Color32[] GetPixels32() { return null; } }
    public class TooltipAttribute : Attribute { public TooltipAttribute(string text) { } }
    public static class Debug { public static void Log(object what) { } }
    public static class GUI { public static void Label(Rect at, string text) { } }
    public static class Screen { public static int width, height; }
}

namespace UnityEngine.Networking
{
    public class DownloadHandler { public byte[] data; public string text; }
    public class DownloadHandlerBuffer : DownloadHandler { }
    public class UploadHandler { public string contentType; }
    public class UploadHandlerRaw : UploadHandler { public UploadHandlerRaw(byte[] data) { } }
    public class Operation { public bool isDone; }
    public class UnityWebRequest : IDisposable
    {
        public enum Result { InProgress, Success }
        public Result result;
        public string error;
        public long responseCode;
        public DownloadHandler downloadHandler;
        public UploadHandler uploadHandler;
        public UnityWebRequest(string url, string method) { }
        public UnityWebRequest(string url, string method, DownloadHandler download, UploadHandler upload) { }
        public static UnityWebRequest Get(string url) { return null; }
        public void SetRequestHeader(string name, string value) { }
        public Operation SendWebRequest() { return null; }
        public void Dispose() { }
    }
}

namespace Unity.Collections { public struct NativeArray<T> where T : struct { public int Length; } }

namespace Unity.Collections.LowLevel.Unsafe
{
    public static class NativeArrayUnsafeUtility { public static unsafe void* GetUnsafeReadOnlyPtr<T>(NativeArray<T> array) where T : struct { return null; } }
}

namespace UnityEngine.XR.ARSubsystems
{
    public struct XRCameraIntrinsics { public Vector2 focalLength, principalPoint; public Vector2Int resolution; }
    public struct XRCpuImage : IDisposable
    {
        public struct Plane { public int rowStride; public Unity.Collections.NativeArray<byte> data; }
        public int width, height;
        public double timestamp;
        public Plane GetPlane(int index) { return default(Plane); }
        public void Dispose() { }
    }
}

namespace UnityEngine.XR.ARFoundation
{
    using UnityEngine.XR.ARSubsystems;

    public enum ARSessionState { SessionTracking }
    public class ARSession { public static ARSessionState state; }
    public class ARCameraManager : MonoBehaviour
    {
        public bool TryGetIntrinsics(out XRCameraIntrinsics found) { found = default(XRCameraIntrinsics); return false; }
        public bool TryAcquireLatestCpuImage(out XRCpuImage found) { found = default(XRCpuImage); return false; }
    }
}

namespace UnityEditor
{
    public class MenuItemAttribute : Attribute { public MenuItemAttribute(string path) { } }
    public static class Selection { public static UnityEngine.GameObject activeGameObject; }
}

namespace UnityEditor.SceneManagement
{
    public enum NewSceneSetup { DefaultGameObjects }
    public struct Scene { }
    public static class EditorSceneManager
    {
        public static Scene NewScene(NewSceneSetup setup) { return default(Scene); }
        public static bool SaveScene(Scene scene, string path) { return false; }
    }
}

namespace NUnit.Framework
{
    public class TestAttribute : Attribute { }
    public static class Assert
    {
        public static void IsNotEmpty(string text) { }
        public static void AreEqual(object expected, object actual) { }
        public static T Throws<T>(Action body) where T : Exception { return null; }
    }
}
