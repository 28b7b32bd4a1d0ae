// The menu veiloc > Make the sample scene.
using UnityEditor;
using UnityEditor.SceneManagement;
using UnityEngine;

namespace Veiloc.Samples
{
    public static class MakeScene
    {
        [MenuItem("veiloc/Make the sample scene")]
        static void Make()
        {
            var scene = EditorSceneManager.NewScene(NewSceneSetup.DefaultGameObjects);
            Selection.activeGameObject = new GameObject("Where am I?", typeof(WhereAmI));
            EditorSceneManager.SaveScene(scene, "Assets/WhereAmI.unity");
        }
    }
}
