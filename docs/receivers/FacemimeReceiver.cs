// Receives the moved vertices of Facemime's heads over TCP.
//
// In Unity, add this file to the project and the component "Facemime Receiver" to an empty object; it makes a child with
// a mesh for each head. In other programs, use FacemimeStream alone: it listens, and Update calls back for each mesh and
// frame that was received.
//
// SPDX-License-Identifier: GPL-3.0-or-later

using System;
using System.Collections.Generic;
using System.IO;
using System.Net;
using System.Net.Sockets;
using System.Text;
using System.Threading;

// A head at rest: vertices as consecutive x, y, z, and the corners of its triangles, anticlockwise from outside.
// Axes: x right, y up, z towards the viewer.
public sealed class FacemimeMesh
{
    public int Head;
    public string Name;
    public float[] Rest;
    public int[] Corners;
}

// A frame: all vertices, and the pose of the head as rows of a rotation and a translation.
public sealed class FacemimeFrame
{
    public int Head;
    public double Time;
    public float[] Vertices;
    public float[] Rotation;
    public float[] Translation;
}

// Listens for one sender at a time. Only the newest frame of each head is kept.
public sealed class FacemimeStream : IDisposable
{
    const int MostBytes = 256000000;

    readonly TcpListener listener;
    readonly Thread thread;
    readonly object gate = new object();
    readonly List<FacemimeMesh> meshes = new List<FacemimeMesh>();
    readonly Dictionary<int, FacemimeFrame> frames = new Dictionary<int, FacemimeFrame>();
    volatile bool over;
    TcpClient client;

    public FacemimeStream(IPAddress address, int port)
    {
        listener = new TcpListener(address, port);
        listener.Start();
        thread = new Thread(Work) { IsBackground = true };
        thread.Start();
    }

    // Call this from the main thread: what has come since the last call.
    public void Update(Action<FacemimeMesh> onMesh, Action<FacemimeFrame> onFrame)
    {
        List<FacemimeMesh> newMeshes;
        List<FacemimeFrame> newFrames;
        lock (gate)
        {
            newMeshes = new List<FacemimeMesh>(meshes);
            newFrames = new List<FacemimeFrame>(frames.Values);
            meshes.Clear();
            frames.Clear();
        }
        newMeshes.ForEach(onMesh);
        newFrames.ForEach(onFrame);
    }

    public void Dispose()
    {
        over = true;
        listener.Stop();
        lock (gate)
        {
            if (client != null) client.Close();
        }
        thread.Join(1000);
    }

    void Work()
    {
        while (!over)
        {
            try
            {
                TcpClient next = listener.AcceptTcpClient();
                lock (gate) client = next;
                using (next)
                using (BinaryReader reader = new BinaryReader(new BufferedStream(next.GetStream(), 65536)))
                    while (!over) Read(reader);
            }
            catch (IOException) { } // the sender has ended
            catch (SocketException) { }
            catch (ObjectDisposedException) { }
            catch (InvalidDataException) { } // not Facemime
            catch (InvalidOperationException) { }
        }
    }

    void Read(BinaryReader reader)
    {
        int length = reader.ReadInt32();
        if (length < 16 || length > MostBytes) throw new InvalidDataException();
        byte[] data = reader.ReadBytes(length);
        if (data.Length < length) throw new EndOfStreamException();
        if (data[1] != 1) throw new InvalidDataException();
        int head = BitConverter.ToUInt16(data, 2), vertices = BitConverter.ToInt32(data, 4);
        if (data[0] == 1) Add(Mesh(data, head, vertices));
        else if (data[0] == 2) Add(Frame(data, head, vertices));
    }

    void Add(FacemimeMesh mesh)
    {
        lock (gate)
        {
            meshes.Add(mesh);
            frames.Remove(mesh.Head);
        }
    }

    void Add(FacemimeFrame frame)
    {
        lock (gate) frames[frame.Head] = frame;
    }

    static FacemimeMesh Mesh(byte[] data, int head, int vertices)
    {
        int triangles = BitConverter.ToInt32(data, 8), name = BitConverter.ToUInt16(data, 12), start = 14 + name;
        if (vertices < 0 || triangles < 0 || start + 12L * vertices + 12L * triangles != data.Length)
            throw new InvalidDataException();
        FacemimeMesh mesh = new FacemimeMesh { Head = head, Name = Encoding.UTF8.GetString(data, 14, name) };
        mesh.Rest = Floats(data, start, 3 * vertices);
        mesh.Corners = new int[3 * triangles];
        Buffer.BlockCopy(data, start + 12 * vertices, mesh.Corners, 0, 12 * triangles);
        foreach (int corner in mesh.Corners)
            if (corner < 0 || corner >= vertices) throw new InvalidDataException();
        return mesh;
    }

    static FacemimeFrame Frame(byte[] data, int head, int vertices)
    {
        if (vertices < 0 || 64 + 12L * vertices != data.Length) throw new InvalidDataException();
        return new FacemimeFrame
        {
            Head = head,
            Time = BitConverter.ToDouble(data, 8),
            Rotation = Floats(data, 16, 9),
            Translation = Floats(data, 52, 3),
            Vertices = Floats(data, 64, 3 * vertices),
        };
    }

    static float[] Floats(byte[] data, int start, int count)
    {
        float[] values = new float[count];
        Buffer.BlockCopy(data, start, values, 0, 4 * count);
        return values;
    }
}

#if UNITY_5_3_OR_NEWER
// Unity's axes are left-handed, so that z is reversed, and triangles run the other way round.
public sealed class FacemimeReceiver : UnityEngine.MonoBehaviour
{
    public int port = 21575;
    [UnityEngine.Tooltip("Listen on all networks rather than on this computer alone")]
    public bool everywhere;
    public UnityEngine.Material material;

    readonly Dictionary<int, UnityEngine.Mesh> heads = new Dictionary<int, UnityEngine.Mesh>();
    readonly Dictionary<int, UnityEngine.Transform> objects = new Dictionary<int, UnityEngine.Transform>();
    FacemimeStream stream;

    void OnEnable()
    {
        stream = new FacemimeStream(everywhere ? IPAddress.Any : IPAddress.Loopback, port);
    }

    void OnDisable()
    {
        stream.Dispose();
    }

    void Update()
    {
        stream.Update(Show, Move);
    }

    void Show(FacemimeMesh head)
    {
        if (!objects.ContainsKey(head.Head))
        {
            UnityEngine.GameObject made = new UnityEngine.GameObject();
            made.transform.SetParent(transform, false);
            made.AddComponent<UnityEngine.MeshFilter>().mesh = heads[head.Head] = new UnityEngine.Mesh();
            made.AddComponent<UnityEngine.MeshRenderer>().material = material;
            objects[head.Head] = made.transform;
        }
        objects[head.Head].name = head.Name;
        UnityEngine.Mesh mesh = heads[head.Head];
        mesh.Clear();
        mesh.indexFormat = UnityEngine.Rendering.IndexFormat.UInt32;
        mesh.MarkDynamic();
        mesh.vertices = Points(head.Rest);
        int[] corners = (int[])head.Corners.Clone();
        for (int i = 0; i < corners.Length; i += 3) Array.Reverse(corners, i, 3);
        mesh.triangles = corners;
        mesh.RecalculateNormals();
    }

    void Move(FacemimeFrame frame)
    {
        UnityEngine.Mesh mesh;
        if (!heads.TryGetValue(frame.Head, out mesh) || 3 * mesh.vertexCount != frame.Vertices.Length) return;
        mesh.vertices = Points(frame.Vertices);
        mesh.RecalculateNormals();
        mesh.RecalculateBounds();
        float[] r = frame.Rotation;
        UnityEngine.Vector3 forward = new UnityEngine.Vector3(-r[2], -r[5], r[8]);
        UnityEngine.Vector3 up = new UnityEngine.Vector3(r[1], r[4], -r[7]);
        objects[frame.Head].localRotation = UnityEngine.Quaternion.LookRotation(forward, up);
        objects[frame.Head].localPosition =
            new UnityEngine.Vector3(frame.Translation[0], frame.Translation[1], -frame.Translation[2]);
    }

    static UnityEngine.Vector3[] Points(float[] values)
    {
        UnityEngine.Vector3[] points = new UnityEngine.Vector3[values.Length / 3];
        for (int i = 0; i < points.Length; i++)
            points[i] = new UnityEngine.Vector3(values[3 * i], values[3 * i + 1], -values[3 * i + 2]);
        return points;
    }
}
#endif
