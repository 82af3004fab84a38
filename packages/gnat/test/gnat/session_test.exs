defmodule Gnat.SessionTest do
  use ExUnit.Case, async: true

  alias Gnat.{Error, Session}

  # Only passed through.
  @from {:caller, :tag}

  setup do
    {session, [{:write, sub}]} = Session.new(%{max_payload: 10})
    assert IO.iodata_to_binary(sub) =~ ~r/\ASUB _INBOX\.\S+\.\* 0\r\n\z/
    {:ok, session: session, other: spawn(fn -> :ok end)}
  end

  defp run(session, events),
    do: Enum.map_reduce(events, session, fn event, s -> swap(Session.handle(s, event)) end)

  defp swap({session, actions}), do: {actions, session}
  defp written(actions), do: for({:write, iodata} <- actions, do: IO.iodata_to_binary(iodata))

  describe "the pulse" do
    test "asks, and is content with an answer", %{session: session} do
      {[asked, _, answered, again], _} = run(session, [:tick, :heard, {:message, :pong}, :tick])
      assert written(asked) == ["PING\r\n"]
      assert answered == []
      assert written(again) == ["PING\r\n"]
    end

    test "is content with any sign of life, and asks no second time before the first is answered", context do
      {[_, _, busy, _, _, again], _} =
        run(context.session, [:tick, :heard, :tick, :heard, {:message, :pong}, :tick])

      assert busy == []
      assert written(again) == ["PING\r\n"]
    end

    test "without one, ends the connection", %{session: session} do
      {[_, actions], _} = run(session, [:tick, :tick])
      assert actions == [{:stop, Error.new(:unresponsive)}]
    end

    test "answers the server's", %{session: session} do
      {_, actions} = Session.handle(session, {:message, :ping})
      assert written(actions) == ["PONG\r\n"]
    end

    test "keeps the answers to its own questions and to flushes apart", %{session: session} do
      {[_, flushed, first, second, none], _} =
        run(session, [:tick, {:flush, @from}, {:message, :pong}, {:message, :pong}, {:message, :pong}])

      assert written(flushed) == ["PING\r\n"]
      assert first == []
      assert second == [{:reply, @from, :ok}]
      assert none == []
    end
  end

  describe "processes" do
    test "are monitored once, however much they own", %{session: session, other: pid} do
      {[first, second], session} = run(session, [{:sub, @from, pid, "a", nil}, {:sub, @from, pid, "b", "q"}])
      assert [{:monitor, ^pid}, {:write, _}, {:reply, @from, {:ok, 1}}] = first
      assert [{:write, _}, {:reply, @from, {:ok, 2}}] = second
      {session, inbox, []} = Session.request(session, make_ref(), pid)

      {[unsub, ended, last], session} =
        run(session, [{:unsub, 1}, {:forget, inbox}, {:unsub, 2}])

      assert written(unsub) == ["UNSUB 1\r\n"]
      assert ended == []
      assert [{:write, _}, {:demonitor, ^pid}] = last
      assert Session.subscriptions(session) == 1
    end

    test "take all they own with them", %{session: session, other: pid} do
      {session, _inbox, _} = Session.request(session, make_ref(), pid)

      {[_, _, gone], session} =
        run(session, [{:sub, @from, pid, "a", nil}, {:sub, @from, self(), "b", nil}, {:down, pid}])

      assert written(gone) == ["UNSUB 1\r\n"]
      assert Session.subscriptions(session) == 2
      assert {_, []} = Session.handle(session, {:down, pid})
    end
  end

  describe "messages" do
    test "of a subscription that has ended are dropped", %{session: session} do
      assert {^session, []} = Session.handle(session, {:message, {:msg, "a", 9, nil, "x"}})
    end

    test "go to the process that subscribed", %{session: session} do
      message = {:message, {:msg, "a", 1, nil, "x"}}
      {[_sub, delivered], _} = run(session, [{:sub, @from, self(), "a", nil}, message])
      me = self()
      assert [{:send, ^me, {:msg, %{body: "x", sid: 1, reply_to: nil}}}] = delivered
    end

    test "that answer a request go to its alias, only the first one", %{session: session} do
      to = make_ref()
      {session, inbox, [{:monitor, _}]} = Session.request(session, to, self())
      answer = {:message, {:msg, inbox, 0, nil, "x"}}
      me = self()
      {[first, late], _} = run(session, [answer, answer])
      assert [{:send, ^to, {^to, %{body: "x", topic: ^inbox}}}, {:demonitor, ^me}] = first
      assert late == []
    end

    test "of the server change what is known, or are reported", %{session: session} do
      {session, []} = Session.handle(session, {:message, {:info, %{ldm: true, max_payload: 5}}})
      assert %{ldm: true, max_payload: 5} = Session.info(session)
      assert {:error, %Error{reason: {:payload_too_large, 6, 5}}} = Session.check_size(session, 6)
      assert :ok = Session.check_size(session, 5)
      assert {_, [{:server_error, "no"}]} = Session.handle(session, {:message, {:error, "no"}})
      assert {_, []} = Session.handle(session, {:message, :ok})
    end
  end
end
