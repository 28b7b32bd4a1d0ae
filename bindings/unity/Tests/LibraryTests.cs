// In Unity's Test Runner: whether the native library of this platform is in the package. All else is tested with mono (Tests~).
using NUnit.Framework;

namespace Veiloc.Tests
{
    public class LibraryTests
    {
        [Test]
        public void LibraryIsLoadedAndRefusesBytes()
        {
            Assert.IsNotEmpty(Library.Version);
            Assert.AreEqual(Status.Profile, Assert.Throws<VeilocException>(() => Profile.Read(new byte[10])).Status);
        }
    }
}
