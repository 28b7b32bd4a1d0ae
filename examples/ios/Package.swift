// swift-tools-version: 5.9
// A Swift package of the library and the example. Put VeilocFFI.xcframework beside this file and Veiloc.swift into Sources/Veiloc.
import PackageDescription

let package = Package(
    name: "Veiloc",
    platforms: [.iOS(.v15)],
    products: [.library(name: "VeilocExample", targets: ["VeilocExample"])],
    targets: [
        .binaryTarget(name: "VeilocFFI", path: "VeilocFFI.xcframework"),
        .target(name: "Veiloc", dependencies: ["VeilocFFI"], path: "Sources/Veiloc"),
        .target(name: "VeilocExample", dependencies: ["Veiloc"], path: "Sources", exclude: ["Veiloc"], sources: ["Localizer.swift"]),
    ]
)
