// Where frames of ARKit were taken. Not compiled by this project's checks: it needs Xcode.
import ARKit
import Foundation
import Veiloc

/// One map of a service. `locate` blocks: use a background queue.
final class Localizer {
    let alignment: Alignment
    private let server: URL
    private let map: String
    private let sealer: Sealer
    private let session: Session
    private let burst: Burst
    private var misses: UInt32 = 0

    init(server: URL, map: String) throws {
        self.server = server
        self.map = map
        alignment = try Alignment()
        session = try Session()
        burst = try Burst()
        let profile = try Profile(bytes: Localizer.request(server, map, "profile", body: nil).1)
        sealer = try Sealer(profile: profile)
    }

    /// Takes a frame: from `session(_:didUpdate:)`, while the camera is tracked. Returns whether `locate` has a full burst.
    func offer(_ frame: ARFrame) throws -> Bool {
        guard case .normal = frame.camera.trackingState else { return false }
        // The pose of this very frame.
        let m = frame.camera.transform
        let columns = [m.columns.0, m.columns.1, m.columns.2, m.columns.3].flatMap { [$0.x, $0.y, $0.z, $0.w] }
        let pose = CameraPose(axes: .openGl, pose: try poseFromMatrix(columns: columns))
        let k = frame.camera.intrinsics
        let image = frame.capturedImage
        CVPixelBufferLockBaseAddress(image, .readOnly)
        defer { CVPixelBufferUnlockBaseAddress(image, .readOnly) }
        let (width, height) = (CVPixelBufferGetWidthOfPlane(image, 0), CVPixelBufferGetHeightOfPlane(image, 0))
        let stride = CVPixelBufferGetBytesPerRowOfPlane(image, 0)
        guard let base = CVPixelBufferGetBaseAddressOfPlane(image, 0) else { return false }
        // The gray plane, where it is.
        let gray = Data(bytesNoCopy: base, count: stride * height, deallocator: .none)
        let camera = pinholeCamera(
            width: UInt32(width), height: UInt32(height),
            fx: Double(k[0][0]), fy: Double(k[1][1]), cx: Double(k[2][0]), cy: Double(k[2][1]))
        let layout = FrameLayout(format: .gray, width: UInt32(width), height: UInt32(height), rowStride: UInt32(stride))
        _ = try burst.offer(bytes: gray, layout: layout, camera: camera, cameraInWorld: pose, timestamp: frame.timestamp)
        return burst.frames() == 3
    }

    /// Seals the sharpest frames of the last second and asks the service; returns words for the user.
    func locate() throws -> String {
        let sealed: SealedBurst
        do {
            sealed = try burst.seal(sealer: sealer, session: session)
        } catch {
            // Nothing was sent: another burst costs nothing.
            return adviceText(advice: advice(query: nil, answer: nil))
        }
        let (status, body) = try Localizer.request(server, map, "localize-rig", body: sealed.bytes())
        guard status == 200 else {
            if status == 422 { misses += 1 }
            return adviceText(advice: advice(query: sealed.newest(), answer: nil, misses: misses))
        }
        misses = 0
        let answer = try Answer(bytes: body)
        burst.learnUnit(answer: answer)
        // The answer is about the newest frame.
        _ = try alignment.add(answer: answer, cameraInWorld: sealed.cameraInWorld(axes: .openGl))
        return adviceText(advice: advice(query: sealed.newest(), answer: answer))
    }

    /// Where content that is placed in the map is in ARKit's world.
    func worldFromAnchor(_ mapFromAnchor: Pose) throws -> Pose? {
        try alignment.worldFromAnchor(axes: .openGl, mapFromAnchor: mapFromAnchor)
    }

    private static func request(_ server: URL, _ map: String, _ what: String, body: Data?) throws -> (Int, Data) {
        var request = URLRequest(url: server.appendingPathComponent("v1/maps/\(map)/\(what)"))
        request.setValue("application/x-protobuf", forHTTPHeaderField: "Accept")
        if let body {
            request.httpMethod = "POST"
            request.setValue("application/x-protobuf", forHTTPHeaderField: "Content-Type")
            request.httpBody = body
        }
        let done = DispatchSemaphore(value: 0)
        var result: Result<(Int, Data), Error> = .failure(URLError(.unknown))
        URLSession.shared.dataTask(with: request) { data, response, error in
            if let http = response as? HTTPURLResponse, let data {
                result = .success((http.statusCode, data))
            } else if let error {
                result = .failure(error)
            }
            done.signal()
        }.resume()
        done.wait()
        return try result.get()
    }
}
