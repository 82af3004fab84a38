defmodule Aerie.Access.SessionsTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog

  alias Aerie.Access.Sessions
  alias Aerie.Base.{Names, PubSub}

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    gateway = make_ref()
    start_supervised!({PubSub, gateway: gateway})
    path = Path.join(dir, "sessions.json")
    %{gateway: gateway, path: path, options: [gateway: gateway, file: path], now: System.system_time(:second)}
  end

  test "a restart brings back what is open, and nothing that ended; the file has no id", c do
    start_supervised!({Sessions, c.options})
    open = Sessions.open(c.gateway, "ann", 3600)
    ended = Sessions.open(c.gateway, "ann", 3600)
    printed = Sessions.open(c.gateway, nil, 60)
    :ok = Sessions.finish(c.gateway, ended)

    text = File.read!(c.path)
    for id <- [open, ended, printed], do: refute(text =~ id)
    assert Bitwise.band(File.stat!(c.path).mode, 0o777) == 0o600

    stop_supervised!(Sessions)
    assert Sessions.owner(c.gateway, open, c.now) == :error
    start_supervised!({Sessions, c.options})
    assert Sessions.owner(c.gateway, open, c.now) == {:ok, "ann"}
    assert Sessions.owner(c.gateway, printed, c.now) == {:ok, nil}
    assert Sessions.owner(c.gateway, ended, c.now) == :error
    assert Sessions.owner(c.gateway, printed, c.now + 61) == :error
  end

  test "a change of a user ends the user's sessions, and says so", c do
    start_supervised!({Sessions, c.options})
    [ann, bob] = for name <- ["ann", "bob"], do: Sessions.open(c.gateway, name, 3600)
    :ok = PubSub.subscribe(c.gateway, {:notice, :console_sessions})
    PubSub.publish(c.gateway, {:notice, :console_users}, "ann")
    assert_receive {:fleet, {:notice, :console_sessions}, :ended}
    assert Sessions.owner(c.gateway, ann, c.now) == :error
    assert Sessions.owner(c.gateway, bob, c.now) == {:ok, "bob"}
  end

  test "sessions that are over leave the file", c do
    start_supervised!({Sessions, c.options})
    Sessions.open(c.gateway, "gone", -1)
    Sessions.open(c.gateway, "ann", 3600)
    assert File.read!(c.path) =~ "gone"
    sessions = Names.whereis(c.gateway, :console_sessions)
    send(sessions, :look)
    _state = :sys.get_state(sessions)
    refute File.read!(c.path) =~ "gone"
    assert File.read!(c.path) =~ "ann"
  end

  test "a file that cannot be read opens nothing; wrong rows are left out", c do
    row = %{id: Base.encode64(<<1::256>>), user: "ann", until: c.now + 60}

    for {text, warns?} <- [
          {"{", true},
          {"[]", true},
          {JSON.encode!(%{sessions: [%{row | id: "short"}, %{row | until: "soon"}, 7]}), false}
        ] do
      File.write!(c.path, text)
      log = capture_log(fn -> start_supervised!({Sessions, c.options}) end)
      assert log =~ "everybody has to sign in again" == warns?
      assert Names.read(c.gateway, :console_sessions, nil, &:ets.tab2list/1) == []
      stop_supervised!(Sessions)
    end
  end

  test "what cannot be written holds until the next start, and is logged", c do
    start_supervised!({Sessions, c.options})
    File.mkdir!(c.path <> ".new")

    log =
      capture_log(fn ->
        assert {:ok, "ann"} = Sessions.owner(c.gateway, Sessions.open(c.gateway, "ann", 60), c.now)
      end)

    assert log =~ "sessions.json"
    # Without the process nobody is signed in, and there is nothing to end.
    assert Sessions.finish(make_ref(), "an id") == :ok
    assert Sessions.finish(c.gateway, nil) == :ok
  end
end
