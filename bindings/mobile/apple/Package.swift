// swift-tools-version: 5.9
// The library as a Swift package. `xcframework.sh` makes VeilocFFI.xcframework and Sources/Veiloc/Veiloc.swift.
import PackageDescription

let package = Package(
    name: "Veiloc",
    platforms: [.iOS(.v15)],
    products: [.library(name: "Veiloc", targets: ["Veiloc"])],
    targets: [
        .binaryTarget(name: "VeilocFFI", path: "VeilocFFI.xcframework"),
        .target(name: "Veiloc", dependencies: ["VeilocFFI"], path: "Sources/Veiloc"),
    ]
)
