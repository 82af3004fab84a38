defmodule Aerie.CLI.MspTest do
  @moduledoc "`aerie msp`: what is in the file, what is not, and what differs."
  use ExUnit.Case, async: true

  import ExUnit.CaptureIO

  alias Aerie.StandardError
  alias MavCodec.{Frame, Tlog}
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Trace

  @moduletag :tmp_dir
  @at 1_700_000_000_000_000
  @identity for {id, payload} <- [{1, <<0, 1, 46>>}, {2, "BTFL"}, {3, <<4, 5, 5>>}],
                do:
                  {:bytes,
                   MavCodec.Msp.Frame.encode(%MavCodec.Msp.Frame{direction: :reply, id: id, payload: payload})}

  defp file(dir, whats) do
    frames = for what <- whats, frame <- frames(what), do: frame
    path = Path.join(dir, "line.tlog")
    File.write!(path, Tlog.records(frames, signatures: false))
    path
  end

  defp frames(%_message{} = message),
    do: [Frame.from_bytes(MavCodec.encode(message, system: 7, component: 1), nil, @at)]

  defp frames({name, bytes}) when name in [:bytes, :written],
    do: frames_of({name, IO.iodata_to_binary(bytes)})

  defp frames(what), do: frames_of(what)
  defp frames_of(what), do: Trace.frames({5, what}, system: 7, seq: 0, at: @at)

  defp run(words, dir) do
    {{result, notes}, text} =
      with_io(fn -> StandardError.capture(fn -> Aerie.CLI.call(["msp" | words], dir) end) end)

    {result, text, notes}
  end

  test "a line for each request, reply, refusal and program, as text and as JSON", %{tmp_dir: dir} do
    refusal = MavCodec.Msp.Frame.encode(%MavCodec.Msp.Frame{direction: :error, id: 106})

    attitude =
      MavCodec.Msp.Frame.encode(%MavCodec.Msp.Frame{
        direction: :reply,
        id: 108,
        payload: <<100::16-little, 0::32>>
      })

    heartbeat = MavCodec.encode(%M.Heartbeat{type: 6}, system: 255, component: 190)

    whats =
      @identity ++
        [{:written, "$M<" <> <<0, 108, 108>>}, {:bytes, attitude}, {:bytes, refusal}, {:mavlink, heartbeat}] ++
        [{:client, 1, :up}, {:judged, 1, false}, {:client, 1, :down}, :tick]

    path = file(dir, whats)
    assert {{0, ""}, text, notes} = run(["line.tlog"], dir)

    assert text |> String.split("\n", trim: true) |> Enum.drop(3) == [
             "2023-11-14T22:13:20.000Z 7 > ATTITUDE",
             "2023-11-14T22:13:20.000Z 7 < ATTITUDE pitch=0 roll=100 yaw=0",
             "2023-11-14T22:13:20.000Z 7 ! RAW_GPS",
             "2023-11-14T22:13:20.000Z 7 MAVLink HEARTBEAT autopilot=0 base_mode=0 custom_mode=0 mavlink_version=3 system_status=0 type=6",
             "2023-11-14T22:13:20.000Z 7 program 1 joined",
             "2023-11-14T22:13:20.000Z 7 program 1 denied",
             "2023-11-14T22:13:20.000Z 7 program 1 left"
           ]

    assert notes =~ "7: 11 entries; the recording begins after the line was opened"

    assert {{0, ""}, json, _notes} = run([path, "--json"], dir)

    assert %{"what" => "reply", "name" => "API_VERSION", "values" => %{"api_minor" => 46}, "at" => @at} =
             json |> String.split("\n") |> hd() |> JSON.decode!()
  end

  test "what the session would not have said ends with status 1, and with both", %{tmp_dir: dir} do
    file(dir, [:opened, %M.Heartbeat{type: 2}])
    assert {{1, ""}, _text, notes} = run(["line.tlog"], dir)

    assert notes =~
             ~r/7: done again, the frame of 2023-11-14T22:13:20.000Z differs: recorded fd[0-9a-f]+, now nothing/
  end

  test "files without MSP, and none", %{tmp_dir: dir} do
    file(dir, [%M.Heartbeat{type: 2}])
    assert {{:error, text}, "", _notes} = run(["line.tlog"], dir)
    assert text =~ "no MSP in this recording: record the link"
    File.write!(Path.join(dir, "noise"), :binary.copy("noise", 100))
    assert {{:error, _text}, "", _notes} = run(["noise"], dir)
    assert {{:error, text}, "", _notes} = run(["none.tlog"], dir)
    assert text =~ "no such file"
  end
end
