// The library for Android as an AAR. `build.sh` puts the native libraries and the Kotlin sources into build/generated first.
plugins {
    id("com.android.library") version "8.7.3"
    id("org.jetbrains.kotlin.android") version "2.1.0"
    `maven-publish`
}

group = "org.veiloc"
version = "0.1.0"

android {
    namespace = "org.veiloc"
    compileSdk = 35

    defaultConfig {
        // Android 8: the first one on which ARCore's current releases run on all devices.
        minSdk = 26
        consumerProguardFiles("consumer-rules.pro")
    }

    sourceSets["main"].apply {
        jniLibs.srcDir(layout.buildDirectory.dir("generated/jniLibs"))
        kotlin.srcDir(layout.buildDirectory.dir("generated/kotlin"))
    }

    // Libraries stay uncompressed and aligned to pages of 16 kB in the app.
    packaging { jniLibs { useLegacyPackaging = false } }

    compileOptions {
        sourceCompatibility = JavaVersion.VERSION_17
        targetCompatibility = JavaVersion.VERSION_17
    }

    publishing { singleVariant("release") { withSourcesJar() } }
}

kotlin { jvmToolchain(17) }

dependencies {
    // The bridge of UniFFI's Kotlin.
    api("net.java.dev.jna:jna:5.17.0@aar")
    api("org.jetbrains.kotlinx:kotlinx-coroutines-core:1.10.2")
}

publishing {
    publications {
        register<MavenPublication>("release") {
            artifactId = "veiloc"
            afterEvaluate { from(components["release"]) }
        }
    }
}
