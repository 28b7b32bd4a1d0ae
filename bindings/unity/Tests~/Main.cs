// The wrapper of the Unity package on mono. Run by scripts/phones/run.py:
//
//     seals PROFILE FRAMES_FOLDER REPEAT
//     locate HOST PORT MAP MODEL WIDTH,HEIGHT,PARAMS POSES FRAME.pgm...
using System;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Net;
using System.Text;
using System.Threading;
using Veiloc;

static class Program
{
    static double Number(string text) { return double.Parse(text, CultureInfo.InvariantCulture); }

    static void Expect(bool isTrue, string what) { if (!isTrue) throw new Exception("failed: " + what); }

    static void Throws(Status status, string what, Action body)
    {
        try { body(); }
        catch (VeilocException error)
        {
            Expect(error.Status == status && error.Message.Length > 5, what + ": " + error.Status + " " + error.Message);
            return;
        }
        throw new Exception(what + ": no exception");
    }

    static void Seals(string[] arguments)
    {
        int count = 0, repeat = int.Parse(arguments[2]);
        using (var profile = Profile.Read(File.ReadAllBytes(arguments[0])))
        using (var sealer = Sealer.For(profile))
        {
            Expect(profile.Id.Length == 32 && Library.Version.Length > 2, "an id and a version");
            using (var answer = Answer.Read(File.ReadAllBytes(Path.Combine(arguments[1], "answer"))))
            {
                Expect(answer.Json() == File.ReadAllText(Path.Combine(arguments[1], "answer.json")), "the document of an answer");
                Expect(answer.Info.MetresPerUnit == 1 && answer.Info.DownY == -1, "unit and down");
            }
            foreach (var line in File.ReadAllLines(Path.Combine(arguments[1], "frames.txt")))
            {
                var words = line.Split(' ');
                var camera = new Camera { Model = words[3], Width = uint.Parse(words[1]), Height = uint.Parse(words[2]), Params = words.Skip(4).Select(Number).ToArray() };
                var layout = new FrameLayout { Format = PixelFormat.Rgba, Width = camera.Width, Height = camera.Height };
                var pixels = File.ReadAllBytes(Path.Combine(arguments[1], words[0] + ".rgba"));
                var expected = File.ReadAllBytes(Path.Combine(arguments[1], words[0] + ".query"));
                var seed = Enumerable.Repeat((byte)int.Parse(words[0]), 32).ToArray();
                for (int i = 0; i < (count == 0 ? repeat + 1 : 1); i++)
                    using (var extracted = sealer.Extract(pixels, layout, camera))
                    using (var query = sealer.SealSeeded(extracted, seed))
                    {
                        Expect(query.Bytes().SequenceEqual(expected), "frame " + words[0] + " equals the reference");
                        Expect(query.Info.Steps.Last() == query.Info.Rows && query.Info.Brightness > 0, "the numbers of a query");
                    }
                if (count == 0)
                {
                    Border(profile, sealer, pixels, layout, camera);
                    Packs(arguments[1], pixels, layout, camera);
                    Masks(sealer, arguments[1], layout, camera);
                    Cancelled(sealer, pixels, layout, camera);
                }
                count++;
            }
        }
        Console.WriteLine(count + " queries equal, " + repeat + " repeated");
    }

    static void Border(Profile profile, Sealer sealer, byte[] pixels, FrameLayout layout, Camera camera)
    {
        Throws(Status.Profile, "a profile", () => Profile.Read(new byte[10]));
        Throws(Status.Answer, "an answer", () => Answer.Read(new byte[0]));
        Throws(Status.Session, "a session", () => Session.Read(new byte[3]));
        Throws(Status.Argument, "anchors", () => Session.Begin("nowhere"));
        Throws(Status.Argument, "a unit", () => Alignment.Begin(-1));
        var wrong = new Camera { Model = camera.Model, Width = 1, Height = camera.Height, Params = camera.Params };
        Throws(Status.Image, "a size", () => sealer.Extract(pixels, layout, wrong));
        var gray = new FrameLayout { Width = layout.Width, Height = layout.Height };
        Throws(Status.Texture, "a black frame", () => sealer.Seal(sealer.Extract(new byte[layout.Width * layout.Height], gray, camera)));
        var pose = new Pose(1, 2, 3, 0, 0, 0, 1);
        using (var session = Session.Begin("gravity"))
        using (var extracted = sealer.Extract(pixels, layout, camera, Axes.Unity, pose))
        using (var query = sealer.Seal(extracted, session))
        using (var restored = Session.Read(session.ToBytes()))
        {
            Throws(Status.Argument, "a frame is sealed once", () => sealer.Seal(extracted, session));
            Expect(restored.Info.Frames == 1 && restored.Info.Starts == 1 && query.Info.Keypoints > 0, "a session");
            Expect(Library.Text(Library.AdviceFor(query.Info, null)).Length > 5, "an advice");
        }
        Bursts(profile, pixels, layout, camera, pose);
        Throws(Status.Answer, "no anchors", () => Anchors.Read(new byte[3]));
        using (var alignment = Alignment.Begin())
        using (var anchors = Anchors.Read(Encoding.UTF8.GetBytes("{\"version\":1,\"anchors\":[]}")))
            Expect(anchors.Place(alignment, pose).Length == 0, "anchors before an answer");
        using (var alignment = Alignment.Begin()) Throws(Status.NotAligned, "no answer", () => alignment.WorldFromAnchor(pose));
        var part = Camera.Pinhole(4, 4, 1, 1, 2, 2).Cropped(1, 0, 3, 2);
        Expect(part.Width == 3 && part.Height == 2 && part.Params.SequenceEqual(new[] { 1.0, 1, 1, 2 }), "a part of an image");
        Throws(Status.Argument, "a part", () => part.Cropped(1, 0, 3, 2));
        Expect(new Pose(1, 2, 3, 0, 1, 0, 0).Composed(new Pose(0, 0, 0.5, 0, 0, 0, 1)).Z == 2.5, "a lens on a head");
        profile.Id.ToString();
    }

    // Nothing under a mask reaches the query (rule L13): a frame with other pixels there gives the query of the reference.
    static void Masks(Sealer sealer, string folder, FrameLayout layout, Camera camera)
    {
        var hidden = File.ReadAllBytes(Path.Combine(folder, "hidden.rgba"));
        layout.Mask = new Mask { Kind = MaskKind.ArcoreSemantics, Width = 40, Height = 30, RowStride = 48, Bytes = File.ReadAllBytes(Path.Combine(folder, "mask")) };
        using (var extracted = sealer.Extract(hidden, layout, camera))
        using (var query = sealer.SealSeeded(extracted, new byte[32]))
            Expect(query.Bytes().SequenceEqual(File.ReadAllBytes(Path.Combine(folder, "masked"))), "the mask hides");
        layout.Mask.Margin = -1;
        Throws(Status.Image, "a margin", () => sealer.Extract(hidden, layout, camera));
    }

    // The first frame sealed with the pack: equal to the reference, or refused where the frame does not show the place.
    static void Packs(string folder, byte[] pixels, FrameLayout layout, Camera camera)
    {
        var bytes = File.ReadAllBytes(Path.Combine(folder, "pack"));
        var expected = File.ReadAllBytes(Path.Combine(folder, "matched"));
        Throws(Status.Pack, "a damaged pack", () => Pack.Read(bytes.Take(bytes.Length - 1).ToArray()));
        using (var pack = Pack.Read(bytes))
        using (var profile = pack.ToProfile())
        {
            Expect(pack.Id.Length == 32 && profile.Id.Length == 32, "ids");
            Throws(Status.Argument, "explained without a pack", () => Sealer.For(profile, send: PackUse.Explained));
            using (var sealer = Sealer.For(profile, pack: pack))
            using (var extracted = sealer.Extract(pixels, layout, camera))
            {
                if (expected.Length == 0) Throws(Status.NotThisPlace, "another place", () => sealer.SealSeeded(extracted, new byte[32]));
                else using (var query = sealer.SealSeeded(extracted, new byte[32])) Expect(query.Bytes().SequenceEqual(expected), "matches");
                // Two squares have fewer keypoints than a place must explain.
                var squares = new byte[layout.Width * layout.Height];
                for (uint i = 0; i < squares.Length; i++)
                {
                    uint column = i % layout.Width / 20, row = i / layout.Width / 20;
                    squares[i] = (byte)(row == 7 && (column == 7 || column == 14) ? 30 : 200);
                }
                var gray = new FrameLayout { Width = layout.Width, Height = layout.Height };
                Throws(Status.NotThisPlace, "two squares", () => sealer.Seal(sealer.Extract(squares, gray, camera)));
            }
        }
    }

    // The newest frame is the rig, a black one is left out, and a burst without texture leaves the session.
    static void Bursts(Profile profile, byte[] pixels, FrameLayout layout, Camera camera, Pose pose)
    {
        Throws(Status.Argument, "six frames", () => Burst.Begin(new BurstOptions { Frames = 6 }));
        var gray = new FrameLayout { Width = layout.Width, Height = layout.Height };
        var dark = new byte[layout.Width * layout.Height];
        var moved = new Pose(1.02, 2, 3, 0, 0, 0, 1);
        using (var session = Session.Begin())
        using (var sealer = Sealer.For(profile, sendGravity: false))
        using (var burst = Burst.Begin(new BurstOptions { MetresPerUnit = 1 }))
        {
            Throws(Status.Argument, "a time", () => burst.Offer(pixels, layout, camera, pose, double.NaN));
            Throws(Status.Argument, "no frame", () => burst.Seal(sealer, session));
            burst.Offer(dark, gray, camera, pose, 1);
            Throws(Status.Texture, "a black burst", () => burst.Seal(sealer, session));
            Expect(burst.Frames == 0 && session.Info.Frames == 0, "the session has not changed");
            burst.Offer(pixels, layout, camera, pose, 2);
            burst.Offer(dark, gray, camera, pose, 2.4);
            burst.Offer(pixels, layout, camera, moved, 2.8);
            using (var made = burst.Seal(sealer, session))
            {
                Expect(made.Info.Frames == 2 && made.Info.LeftOut == 1 && session.Info.Frames == 2, "two frames");
                Expect(made.Info.Newest.Keypoints > 0 && Math.Abs(made.CameraInWorld().X - 1.02) < 1e-9, "the newest frame");
                Expect(made.Bytes().Length > 1000 && made.Bytes()[7] == 2, "a rig of two frames");
            }
            burst.Offer(pixels, layout, camera, pose, 3.2);
            burst.Clear();
            Expect(burst.Frames == 0, "no frames");
        }
    }

    // Another thread cancels while frames are sealed.
    static void Cancelled(Sealer sealer, byte[] pixels, FrameLayout layout, Camera camera)
    {
        using (var session = Session.Begin())
        using (var cancellation = Cancellation.Begin())
        {
            using (var extracted = sealer.Extract(pixels, layout, camera, cancellation: cancellation)) sealer.Seal(extracted, session).Dispose();
            var thread = new Thread(cancellation.Cancel);
            thread.Start();
            Throws(Status.Cancelled, "a cancelled call", () =>
            {
                for (int i = 0; i < 1000; i++) sealer.Extract(pixels, layout, camera, cancellation: cancellation).Dispose();
            });
            thread.Join();
            Throws(Status.Cancelled, "later ones", () => sealer.Extract(pixels, layout, camera, cancellation: cancellation));
            Expect(session.Info.Frames == 1, "the session has not changed");
        }
    }

    static byte[] Request(string url, byte[] body)
    {
        var request = (HttpWebRequest)WebRequest.Create(url);
        request.Accept = "application/x-protobuf";
        request.KeepAlive = false;
        request.ServicePoint.Expect100Continue = false;
        if (body != null)
        {
            request.Method = "POST";
            request.ContentType = "application/x-protobuf";
            using (var stream = request.GetRequestStream()) stream.Write(body, 0, body.Length);
        }
        using (var response = request.GetResponse())
        using (var copy = new MemoryStream())
        {
            response.GetResponseStream().CopyTo(copy);
            return copy.ToArray();
        }
    }

    // The poses are ARKit's. An app of Unity passes Axes.Unity, the default.
    static void Locate(string[] arguments)
    {
        var url = "http://" + arguments[0] + ":" + arguments[1] + "/v1/maps/" + arguments[2];
        var numbers = arguments[4].Split(',').Select(Number).ToArray();
        var camera = new Camera { Model = arguments[3], Width = (uint)numbers[0], Height = (uint)numbers[1], Params = numbers.Skip(2).ToArray() };
        var layout = new FrameLayout { Format = PixelFormat.Gray, Width = camera.Width, Height = camera.Height };
        var poses = File.ReadAllLines(arguments[5]).Select(line => line.Split(' ').Select(Number).ToArray()).ToArray();
        using (var profile = Profile.Read(Request(url + "/profile", null)))
        using (var sealer = Sealer.For(profile))
        using (var session = Session.Begin())
        using (var burst = Burst.Begin())
        using (var alignment = Alignment.Begin())
        {
            for (int i = 0; i + 6 < arguments.Length; i++)
            {
                var file = File.ReadAllBytes(arguments[i + 6]);
                var p = poses[i];
                var pixels = file.Skip(file.Length - (int)(camera.Width * camera.Height)).ToArray();
                burst.Offer(pixels, layout, camera, new Pose(p[1], p[2], p[3], p[4], p[5], p[6], p[7]), p[0], Axes.OpenGl);
                if (burst.Frames < 3) continue;
                using (var made = burst.Seal(sealer, session))
                using (var answer = Answer.Read(Request(url + "/localize-rig", made.Bytes())))
                {
                    var pose = made.CameraInWorld(Axes.OpenGl);
                    var update = alignment.Add(answer, pose, Axes.OpenGl);
                    var found = answer.CameraInMap(Axes.OpenGl);
                    Console.WriteLine(string.Format(CultureInfo.InvariantCulture, "{0} {1} {2} {3} {4} {5} {6:F4} m", i,
                        answer.Info.Trusted ? "trusted" : "doubtful", found.X, found.Y, found.Z, update,
                        answer.Accuracy(pose, Axes.OpenGl).Horizontal));
                    Console.WriteLine("  " + Library.Text(Library.AdviceFor(made.Info.Newest, answer)));
                }
            }
            var info = alignment.Info;
            Console.WriteLine("alignment state " + (int)info.State + " used " + info.Used + " distances " + (int)info.Distances);
            var a = alignment.WorldFromAnchor(new Pose(0, 0, 0, 0, 0, 0, 1), Axes.OpenGl);
            Console.WriteLine(string.Format(CultureInfo.InvariantCulture, "anchor {0} {1} {2} {3} {4} {5} {6}", a.X, a.Y, a.Z, a.Qx, a.Qy, a.Qz, a.Qw));
        }
    }

    static void Main(string[] arguments)
    {
        var rest = arguments.Skip(1).ToArray();
        if (arguments[0] == "seals") Seals(rest);
        else Locate(rest);
    }
}
