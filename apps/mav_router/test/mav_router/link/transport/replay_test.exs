defmodule MavRouter.Link.Transport.ReplayTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import ExUnit.CaptureLog

  alias MavRouter.Link

  @moduletag :tmp_dir
  @fixture Path.expand("../../../../../mav_codec/test/fixtures/captures/px4_flight_start.tlog.gz", __DIR__)

  setup c do
    path = Path.join(c.tmp_dir, "flight.tlog")
    File.write!(path, @fixture |> File.read!() |> :zlib.gunzip())
    {:ok, path: path, gateway: start_parts(), recorded: Enum.to_list(MavCodec.Tlog.Reader.frames!(path))}
  end

  test "as fast as possible: all frames, in order, with their times, then the end", c do
    be_session(c.gateway, 1)
    listen(c.gateway, [:ended])
    {id, _} = add_link(c.gateway, "replay:#{c.path}?speed=max")
    frames = frames(length(c.recorded))
    assert_receive {:ended, _, %{reason: reason}}
    assert Enum.map(frames, &{&1.at, &1.bytes}) == Enum.map(c.recorded, &{&1.at, &1.bytes})
    refute_received {:frames, _, _}

    assert reason == "end of #{c.path} after #{length(frames)} frames"
    assert %{status: :ended, text: ^reason} = snapshot(c.gateway, id)
    assert snapshot(c.gateway, id).counters.frames_in == length(frames)
    # A recording is read-only.
    :ok = Link.send_bytes(c.gateway, id, "x", :all)
    assert snapshot(c.gateway, id).counters.dropped_out == 1
  end

  test "a gzipped recording, in a loop", c do
    be_session(c.gateway, 1)
    add_link(c.gateway, "replay:#{@fixture}?speed=max&loop=true")
    n = length(c.recorded)
    frames = Enum.take(frames(2 * n), 2 * n)
    assert Enum.map(frames, & &1.bytes) == Enum.map(c.recorded ++ c.recorded, & &1.bytes)
  end

  test "waits for a session that does not keep up", c do
    be_session(c.gateway, 1)
    listen(c.gateway, [:ended])
    {_id, _} = add_link(c.gateway, "replay:#{c.path}?speed=max&loop=true")
    # Nobody reads: the loop does not get further than this.
    eventually(fn -> waiting() > 16 end)
    assert waiting() < 40
    frames(3 * length(c.recorded))
    refute_received {:ended, _, _}
  end

  defp waiting, do: self() |> Process.info(:message_queue_len) |> elem(1)

  test "a damaged recording delivers its good frames and reports the damage", c do
    bytes = File.read!(c.path)
    File.write!(c.path, binary_part(bytes, 0, byte_size(bytes) - 5))
    be_session(c.gateway, 1)
    listen(c.gateway, [:ended])
    add_link(c.gateway, "replay:#{c.path}?speed=max")
    assert length(frames(length(c.recorded) - 1)) == length(c.recorded) - 1
    assert_receive {:ended, _, %{reason: reason}}
    assert reason =~ "the file ends in the middle of a record"
  end

  describe "impossible times" do
    @times Path.expand("../../../../../mav_codec/test/fixtures/recordings", __DIR__)

    for name <- ["clock-set.tlog", "first-zero.tlog"] do
      test "#{name}: what was recorded before the clock was set is played, and then at once what came after",
           c do
        be_session(c.gateway, 1)
        listen(c.gateway, [:ended])
        path = Path.join(@times, unquote(name))

        log =
          capture_log(fn ->
            add_link(c.gateway, "replay:#{path}?speed=100")
            assert length(frames(41)) == 41
          end)

        assert log =~ "the recording's time goes on by 1"
        assert_receive {:ended, _, %{reason: reason}}
        assert reason == "end of #{path} after 41 frames"
      end
    end

    for {name, text} <- [
          {"nanoseconds.tlog", "not nanoseconds"},
          {"all-2pow63.tlog", "not nanoseconds"},
          {"raw.rlog", "raw MAVLink log, not a tlog"}
        ] do
      test "#{name} is not played, and says why", c do
        be_session(c.gateway, 1)
        listen(c.gateway, [:ended])
        {id, _} = add_link(c.gateway, "replay:#{Path.join(@times, unquote(name))}")
        assert_receive {:ended, _, %{reason: reason}}
        assert reason =~ unquote(text)
        assert snapshot(c.gateway, id).counters.frames_in == 0
      end
    end
  end

  test "what cannot be replayed is an error", c do
    assert {:error, %{reason: {:invalid, "there is no file /nowhere/x.tlog"}}} =
             Link.start(c.gateway, "replay:/nowhere/x.tlog")

    assert {:error, %Aerie.Base.Error{} = error} = Link.start(c.gateway, "replay:#{c.tmp_dir}")
    assert Exception.message(error) =~ "is a folder"
    File.write!(c.path, "")

    assert {:error, %{reason: {:invalid, "the recording is empty"}}} =
             Link.start(c.gateway, "replay:#{c.path}")

    File.write!(c.path, "this is not a recording")
    be_session(c.gateway, 1)
    listen(c.gateway, [:ended])
    add_link(c.gateway, "replay:#{c.path}?speed=max&loop=true")
    assert_receive {:ended, _, %{reason: reason}}
    assert reason =~ "after 0 frames"
  end
end
