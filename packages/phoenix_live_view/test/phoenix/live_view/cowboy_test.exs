defmodule Phoenix.LiveView.CowboyTest do
  @moduledoc "The server over real connections, frame by frame: what the specification of the wire says row by row."
  use ExUnit.Case, async: true

  alias Phoenix.LiveView.{Channel, Token}
  alias Phoenix.LiveViewTest.{Site, Wire}

  @moduletag :capture_log

  setup context do
    site = Site.start(context[:site] || [])
    %{site: site, port: site.port}
  end

  defp joined(port, path \\ "/") do
    page = Wire.page(port, path)
    {:ok, socket} = Wire.open(page)

    assert ["1", "1", topic, "phx_reply", %{"status" => "ok", "response" => response}] =
             Wire.join(socket, page)

    %{socket: socket, page: page, topic: topic, response: response}
  end

  defp event(%{socket: socket, topic: topic}, ref, payload) do
    Wire.push(socket, ["1", ref, topic, "event", payload])
    Wire.recv(socket)
  end

  defp click(view, ref, name, value \\ %{}), do: event(view, ref, %{type: "click", event: name, value: value})

  # One that has ended may still be in its supervisor's list.
  defp views(%{server: %{supervisor: supervisor}}) do
    for {_, pid, _, _} <- DynamicSupervisor.which_children(supervisor), Process.alive?(pid), do: pid
  end

  describe "a page" do
    test "is not kept, has a policy without inline script and style, and sets a cookie that scripts cannot read",
         %{port: port} do
      {200, headers, body} = Wire.get(port, "/")
      headers = Map.new(headers)
      assert headers["cache-control"] == "no-store"
      assert headers["content-security-policy"] =~ "default-src 'self'"
      refute headers["content-security-policy"] =~ "unsafe"
      assert headers["set-cookie"] =~ "HttpOnly; SameSite=Lax"
      assert body =~ ~s(<title data-default="site">0</title>)
      assert body =~ "data-phx-main"
    end

    test "that is not there, or refuses with a status, has that status", %{port: port} do
      assert {404, _, _} = Wire.get(port, "/nothing")
      assert {404, _, _} = Wire.get(port, "/gone")
    end

    test "is refused after a join was, once", %{port: port, site: site} do
      token = Token.sign(site.server.secret, "reload", 404)
      assert {404, headers, _} = Wire.get(port, "/", [{"cookie", "__phoenix_reload_status__=" <> token}])
      assert Enum.any?(headers, &match?({"set-cookie", "__phoenix_reload_status__=; " <> _}, &1))
      forged = Token.sign(:crypto.strong_rand_bytes(32), "reload", 404)
      assert {200, _, _} = Wire.get(port, "/", [{"cookie", "__phoenix_reload_status__=" <> forged}])
    end
  end

  describe "a WebSocket" do
    test "needs its own origin, the session's token and the version", %{port: port} do
      page = Wire.page(port)
      assert {:refused, 403} = Wire.open(page, origin: "http://evil.example")
      assert {:refused, 403} = Wire.open(page, query: %{"vsn" => "2.0.0"})

      assert {:refused, 403} =
               Wire.open(page, query: %{"vsn" => "2.0.0", "_csrf_token" => Wire.page(port).csrf})

      assert {:refused, 403} = Wire.open(page, query: %{"vsn" => "1.0.0", "_csrf_token" => page.csrf})
      assert {:refused, 403} = Wire.open(page, cookie: nil)
      assert {:ok, _socket} = Wire.open(page)
      assert {:ok, _no_browser} = Wire.open(page, origin: nil)
    end

    test "answers heartbeats, leaves twice, and names unknown topics", %{port: port} do
      view = joined(port)
      Wire.push(view.socket, [nil, "9", "phoenix", "heartbeat", %{}])

      assert [nil, "9", "phoenix", "phx_reply", %{"status" => "ok", "response" => %{}}] =
               Wire.recv(view.socket)

      for ref <- ["10", "11"] do
        Wire.push(view.socket, ["1", ref, view.topic, "phx_leave", %{}])
        assert ["1", ^ref, _, "phx_reply", %{"status" => "ok"}] = Wire.recv(view.socket)
      end

      assert [
               "1",
               "12",
               _,
               "phx_reply",
               %{"status" => "error", "response" => %{"reason" => "unmatched topic"}}
             ] =
               click(view, "12", "up")
    end

    test "ignores what belongs to an earlier join", %{port: port} do
      view = joined(port)
      Wire.push(view.socket, ["0", "8", view.topic, "event", %{type: "click", event: "up", value: %{}}])

      assert ["1", "9", _, "phx_reply", %{"response" => %{"diff" => diff}}] =
               click(view, "9", "up", %{by: "5"})

      assert inspect(diff) =~ "\"5\""
    end

    test "that joins a topic again ends the view before", %{port: port, site: site} do
      view = joined(port)
      [before] = views(site)
      monitor = Process.monitor(before)
      # Another process ends it, and may be faster than the monitor; an answer comes after that.
      :sys.get_state(before, 60_000)

      Wire.push(view.socket, [
        "2",
        "2",
        view.topic,
        "phx_join",
        %{url: "#{site.url}/", params: %{}, session: view.page.session}
      ])

      assert ["2", "2", _, "phx_reply", %{"status" => "ok"}] = Wire.recv(view.socket)
      assert_receive {:DOWN, ^monitor, :process, _, reason}
      assert reason == {:shutdown, :left}
      assert [_one] = views(site)
    end

    @tag site: [max_events: 1]
    test "with more messages than a person can cause is closed", %{port: port} do
      # Each waits for its answer: what is unread when a connection is closed would reset it. Two within a second are too many.
      {:ok, socket} = port |> Wire.page() |> Wire.open()

      answers =
        Stream.repeatedly(fn ->
          Wire.push(socket, [nil, "1", "phoenix", "heartbeat", %{}])
          Wire.recv(socket)
        end)

      assert Enum.find(answers, &(not is_list(&1))) == {:close, 1008}
    end

    @tag site: [max_channels: 1]
    test "has a limited number of views", %{port: port} do
      view = joined(port)
      Wire.push(view.socket, ["2", "2", "lv:another", "phx_join", %{}])

      assert ["2", "2", _, "phx_reply", %{"response" => %{"reason" => "too many channels joined"}}] =
               Wire.recv(view.socket)
    end

    test "with anything but a message, or with uploads, is closed, never with 1000", %{
      port: port
    } do
      for {opcode, data, code} <- [{1, "{}", 1003}, {1, "[1,2]", 1003}, {2, "x", 1003}, {1, <<255>>, 1007}] do
        view = joined(port)
        Wire.frame(view.socket, opcode, data)
        assert last(view.socket) == {:close, code}
      end
    end

    @tag site: [idle_ms: 1]
    test "without a heartbeat is closed so that the client connects again", %{port: port} do
      {:ok, socket} = port |> Wire.page() |> Wire.open()
      assert last(socket) == {:close, 1001}
    end

    test "that is killed takes its views with it", %{port: port, site: site} do
      view = joined(port)
      [pid] = views(site)
      monitor = Process.monitor(pid)
      assert ["1", "3", _, "phx_reply", _] = click(view, "3", "up")
      Wire.push(view.socket, ["1", "4", view.topic, "event", %{type: "click", event: "cut", value: %{}}])
      assert_receive {:DOWN, ^monitor, :process, _, {:shutdown, :closed}}
      assert last(view.socket) == :closed
    end
  end

  # The last thing that is heard.
  defp last(socket) do
    case Wire.recv(socket) do
      [_ | _] -> last(socket)
      other -> other
    end
  end

  describe "a join" do
    # What is wrong, and what the client is told.
    for {name, changes, expected} <- [
          {"a forged token", %{session: "x.y"}, %{"reason" => "stale"}},
          {"no token", %{session: nil}, %{"reason" => "stale"}},
          {"the URL of another view", %{url: "http://127.0.0.1/other/1"}, %{"reason" => "unauthorized"}},
          {"no URL", %{url: nil}, %{"reason" => "unauthorized"}},
          {"another session's view", %{redirect: "http://127.0.0.1/guarded"}, %{"reason" => "unauthorized"}}
        ] do
      test "with #{name} is refused", %{port: port} do
        page = Wire.page(port)
        {:ok, socket} = Wire.open(page)

        assert [
                 "1",
                 "1",
                 _,
                 "phx_reply",
                 %{"status" => "error", "response" => unquote(Macro.escape(expected))}
               ] =
                 Wire.join(socket, page, unquote(Macro.escape(changes)))
      end
    end

    for {path, expected} <- [
          {"/guarded", %{"redirect" => %{"to" => "/login"}}},
          {"/late/crash", %{"reason" => "join crashed"}}
        ] do
      test "of #{path} is answered with #{inspect(expected)}", %{port: port} do
        page = Wire.page(port, unquote(path))
        {:ok, socket} = Wire.open(page)

        assert [_, _, _, "phx_reply", %{"status" => "error", "response" => response}] =
                 Wire.join(socket, page)

        assert response == unquote(Macro.escape(expected))
      end
    end

    test "of what is not there any more makes the client load the page", %{port: port, site: site} do
      page = Wire.page(port, "/late/missing")
      {:ok, socket} = Wire.open(page)

      assert [
               _,
               _,
               _,
               "phx_reply",
               %{"response" => %{"reason" => "reload", "status" => 404, "token" => token}}
             ] = Wire.join(socket, page)

      assert Token.verify(site.server.secret, "reload", token, 60) == {:ok, 404}
    end

    test "with an old token is stale", %{port: port, site: site} do
      page = Wire.page(port)
      {:ok, term} = Token.verify(site.server.secret, "session", page.session, 60)
      old = Token.sign(site.server.secret, "session", term, System.system_time(:second) - 13 * 3600)
      {:ok, socket} = Wire.open(page)

      assert [_, _, _, "phx_reply", %{"response" => %{"reason" => "stale"}}] =
               Wire.join(socket, page, %{session: old})
    end

    test "by live navigation gets the view of its URL, again after a crash", %{port: port} do
      page = Wire.page(port)
      {:ok, socket} = Wire.open(page)

      for _ <- 1..2 do
        assert [
                 _,
                 _,
                 _,
                 "phx_reply",
                 %{"status" => "ok", "response" => %{"rendered" => tree, "liveview_version" => "1.2.12"}}
               ] =
                 Wire.join(socket, page, %{url: nil, redirect: "http://127.0.0.1/other/5"})

        assert inspect(tree) =~ "\"5\""
      end
    end
  end

  describe "an event" do
    # Every event is acknowledged, and never with an error, which would lock the element for good.
    for {name, payload, text} <- [
          {"a click", %{type: "click", event: "up", value: %{by: "3", value: ""}}, "\"3\""},
          {"a command without an element", %{type: nil, event: "seen", value: %{id: "x"}}, "seen x"},
          {"a key", %{type: "keydown", event: "key", value: %{key: "a"}}, "key a"},
          {"a change",
           %{type: "form", event: "change", value: "user[name]=A%20%26", meta: %{_target: "user[name]"}},
           "user"},
          {"a submit", %{type: "form", event: "save", value: "user[name]=B", meta: %{}, uploads: %{}},
           "save B"}
        ] do
      test "#{name} is answered with what it changed", %{port: port} do
        view = joined(port)

        assert ["1", "7", _, "phx_reply", %{"status" => "ok", "response" => %{"diff" => diff}}] =
                 event(view, "7", unquote(Macro.escape(payload)))

        assert JSON.encode!(diff) =~ unquote(text)
      end
    end

    for {name, event, payload} <- [
          {"nothing in it", "event", %{}},
          {"a form that is no text", "event", %{type: "form", event: "save", value: "a=%FF"}},
          {"a patch without a URL", "live_patch", %{}},
          {"an upload", "allow_upload", %{}},
          {"components that went", "cids_destroyed", %{cids: [1]}}
        ] do
      test "with #{name} is acknowledged", %{port: port} do
        view = joined(port)
        Wire.push(view.socket, ["1", "7", view.topic, unquote(event), unquote(Macro.escape(payload))])
        assert ["1", "7", _, "phx_reply", %{"status" => "ok", "response" => %{}}] = Wire.recv(view.socket)
      end
    end

    test "of a hook is answered with its events", %{port: port} do
      view = joined(port)

      assert [_, _, _, _, %{"response" => %{"diff" => diff}}] =
               event(view, "7", %{type: "hook", event: "echo", value: [1]})

      assert diff == %{"e" => [["told", [1]]]}
    end

    test "that crashes the view is reported as such, and the view can be joined again", %{port: port} do
      view = joined(port)
      assert ["1", "1", _, "phx_error", %{}] = click(view, "7", "crash")
      assert [_, _, _, "phx_reply", %{"status" => "ok"}] = Wire.join(view.socket, view.page)
    end
  end

  describe "navigation" do
    # What happens, and what the client hears until it is acknowledged.
    test "a patch by the client changes the view, one to another view does not", %{port: port, site: site} do
      view = joined(port)
      Wire.push(view.socket, ["1", "7", view.topic, "live_patch", %{url: site.url <> "/?q=z"}])
      assert [_, "7", _, "phx_reply", %{"response" => %{"diff" => _}}] = Wire.recv(view.socket)
      Wire.push(view.socket, ["1", "8", view.topic, "live_patch", %{url: site.url <> "/other/1"}])
      assert [_, "8", _, "phx_reply", %{"response" => %{"link_redirect" => true}}] = Wire.recv(view.socket)
    end

    test "a patch by the view is pushed before the answer", %{port: port} do
      view = joined(port)

      assert ["1", nil, _, "live_patch", %{"kind" => "push", "to" => "/?q=pushed"}] =
               click(view, "7", "patch")

      assert ["1", "7", _, "phx_reply", %{"response" => %{"diff" => _}}] = Wire.recv(view.socket)
    end

    test "to a page with a flash is the answer, and closes this view", %{port: port, site: site} do
      view = joined(port)

      assert ["1", "7", _, "phx_reply", %{"status" => "ok", "response" => %{"redirect" => target}}] =
               click(view, "7", "go")

      assert ["1", "1", _, "phx_close", %{}] = Wire.recv(view.socket)
      assert %{"to" => "/other/7", "flash" => flash} = target
      assert Token.verify(site.server.secret, "flash", flash, 60) == {:ok, %{"info" => "hello"}}
      assert {200, _headers, body} = Wire.get(port, "/other/7", [{"cookie", "__phoenix_flash__=" <> flash}])
      assert body =~ "hello"
    end

    test "to a page is the answer", %{port: port} do
      view = joined(port)

      assert ["1", "7", _, "phx_reply", %{"response" => %{"redirect" => %{"to" => "/login"}}}] =
               click(view, "7", "away")
    end
  end

  describe "a browser that does not read" do
    setup %{port: port, site: site} do
      page = Wire.page(port)
      {:ok, socket} = Wire.open(page, recbuf: 4_096)
      [_, _, topic, "phx_reply", %{"status" => "ok"}] = Wire.join(socket, page)
      [pid] = views(site)
      %{socket: socket, topic: topic, pid: pid}
    end

    test "gets the newest state later, and the view waits without a queue", %{pid: pid, socket: socket} do
      :erlang.suspend_process(transport(pid))
      for n <- 1..500, do: send(pid, {:n, n})
      # Answered after the messages before it.
      %{} = :sys.get_state(pid, 60_000)
      {:messages, waiting} = Process.info(transport(pid), :messages)
      assert Enum.count(waiting, &match?({Channel, _, _}, &1)) <= 4
      :erlang.resume_process(transport(pid))
      assert socket |> texts() |> Enum.any?(&(&1 =~ "\"500\""))
    end

    test "ends its view when too many events for its hooks wait", %{pid: pid, socket: socket} do
      transport = transport(pid)
      :erlang.suspend_process(transport)
      monitor = Process.monitor(pid)
      # As if four messages were not written yet: events gather.
      :sys.replace_state(pid, &%{&1 | unwritten: 4})
      for i <- 1..1_001, do: send(pid, {:hook, i})
      assert_receive {:DOWN, ^monitor, :process, _, {:shutdown, :slow}}
      :erlang.resume_process(transport)
      assert ["1", "1", _, "phx_error", %{}] = Wire.recv(socket)
    end
  end

  defp transport(pid), do: :sys.get_state(pid, 60_000).transport

  # Messages up to the one with the newest number.
  defp texts(socket) do
    Stream.repeatedly(fn -> socket |> Wire.recv() |> JSON.encode!() end)
    |> Enum.reduce_while([], fn text, texts ->
      if text =~ "\"500\"", do: {:halt, [text | texts]}, else: {:cont, [text | texts]}
    end)
  end
end
