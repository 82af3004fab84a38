defmodule GnatTest do
  use ExUnit.Case, async: true

  import Gnat.Test

  alias Gnat.Error
  alias Gnat.Test.NatsServer

  setup_all do
    {:ok, server: start_supervised!(NatsServer)}
  end

  setup %{server: server} do
    {:ok, gnat} = Gnat.start_link(NatsServer.settings(server, %{no_responders: true, name: "gnat-test"}))
    {:ok, gnat: gnat, topic: unique("t")}
  end

  describe "connecting" do
    test "returns what the server is", %{gnat: gnat} do
      assert %{version: "2." <> _, max_payload: 1_048_576, headers: true, port: _} = Gnat.server_info(gnat)
    end

    test "to a closed port is an error, not an exit" do
      {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
      {:ok, port} = :inet.port(socket)
      :gen_tcp.close(socket)
      assert {:error, %Error{reason: {:connect, :econnrefused}} = error} = Gnat.start_link(%{port: port})
      assert Exception.message(error) =~ "connection refused"
      refute_received {:EXIT, _, _}
    end

    test "to a silent peer ends with the configured timeout" do
      {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
      {:ok, port} = :inet.port(socket)
      settings = %{host: "127.0.0.1", port: port, connection_timeout: 50}
      assert {:error, %Error{reason: :timeout}} = Gnat.start_link(settings)
    end

    test "to another protocol is an error" do
      {:ok, socket} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}])
      {:ok, port} = :inet.port(socket)

      spawn_link(fn ->
        {:ok, client} = :gen_tcp.accept(socket)
        :gen_tcp.send(client, "SSH-2.0-OpenSSH_9.2\r\n")
        :gen_tcp.recv(client, 0)
      end)

      assert {:error, %Error{reason: {:protocol, text}}} =
               Gnat.start_link(%{host: {127, 0, 0, 1}, port: port, connection_timeout: 60_000})

      assert text =~ "SSH-2.0"
    end

    test "refuses invalid settings, and names them" do
      for {settings, text} <- [
            {%{hots: "a"}, "unknown key :hots"},
            {%{port: 0}, ":port must be 1 to 65535, got: 0"},
            {%{tls: :yes}, ":tls must be true or false"},
            {%{password: :secret}, ":password must be a string"},
            {%{ping_interval: 0}, ":ping_interval must be 1 to 86400000 ms"},
            {%{host: ""}, ":host must be"}
          ] do
        assert {:error, %Error{} = error} = Gnat.start_link(settings)
        assert Exception.message(error) =~ text
        refute Exception.message(error) =~ "secret"
      end
    end

    test "under a taken name returns its owner", %{server: server} do
      name = {:via, Registry, {start_registry(), :nats}}
      {:ok, gnat} = Gnat.start_link(NatsServer.settings(server), name: name)
      assert {:error, {:already_started, ^gnat}} = Gnat.start_link(NatsServer.settings(server), name: name)
      assert :ok = Gnat.pub(name, "a", "b")
    end

    test "as a child of a supervisor", %{server: server} do
      gnat = start_supervised!({Gnat, NatsServer.settings(server)})
      assert :ok = Gnat.pub(gnat, "a", "b")
    end

    defp start_registry do
      name = :"#{unique("registry")}"
      start_supervised!({Registry, keys: :unique, name: name})
      name
    end
  end

  describe "publishing and subscribing" do
    test "a message reaches the subscriber with all its parts", %{gnat: gnat, topic: topic} do
      {:ok, sid} = Gnat.sub(gnat, self(), topic)
      :ok = Gnat.pub(gnat, topic, "hello", reply_to: "back")
      assert_receive {:msg, message}
      assert message == %{topic: topic, body: "hello", reply_to: "back", sid: sid, gnat: gnat}
    end

    test "reply_to is nil when there is none, bodies are any bytes", %{gnat: gnat, topic: topic} do
      {:ok, _} = Gnat.sub(gnat, self(), topic)

      for body <- ["", "\r\n", <<0, 255, 13, 10>>, "MSG a 1 1\r\nx\r\n", :binary.copy("x", 300_000)] do
        :ok = Gnat.pub(gnat, topic, body)
        assert_receive {:msg, %{body: ^body, reply_to: nil}}
      end

      :ok = Gnat.pub(gnat, topic, ["io", [?d, "ata"]])
      assert_receive {:msg, %{body: "iodata"}}
    end

    test "wildcards", %{gnat: gnat, topic: topic} do
      {:ok, one} = Gnat.sub(gnat, self(), topic <> ".*.state")
      {:ok, rest} = Gnat.sub(gnat, self(), topic <> ".>")
      :ok = Gnat.pub(gnat, topic <> ".v1.state", "x")
      assert_receive {:msg, %{sid: ^one}}
      assert_receive {:msg, %{sid: ^rest}}
    end

    test "order is kept over many messages of many sizes", %{gnat: gnat, topic: topic} do
      {:ok, _} = Gnat.sub(gnat, self(), topic)
      bodies = for n <- 1..500, do: "#{n}:" <> :binary.copy("x", rem(n * 7919, 3_000))
      for body <- bodies, do: :ok = Gnat.pub(gnat, topic, body)
      for body <- bodies, do: assert_receive({:msg, %{body: ^body}})
    end

    test "publishes of many processes at once all arrive", %{gnat: gnat, topic: topic} do
      {:ok, _} = Gnat.sub(gnat, self(), topic)

      1..200
      |> Task.async_stream(&Gnat.pub(gnat, topic, "#{&1}"), max_concurrency: 50, timeout: 60_000)
      |> Stream.run()

      got = for _ <- 1..200, do: receive(do: ({:msg, %{body: body}} -> String.to_integer(body)))
      assert Enum.sort(got) == Enum.to_list(1..200)
    end

    test "a queue group shares messages, each goes to one member", %{gnat: gnat, topic: topic} do
      test = self()

      for n <- 1..2 do
        member = spawn_link(fn -> forward_all(test, n) end)
        {:ok, _} = Gnat.sub(gnat, member, topic, queue_group: "workers")
      end

      for n <- 1..50, do: :ok = Gnat.pub(gnat, topic, "#{n}")
      got = for _ <- 1..50, do: receive(do: ({:member, _, body} -> String.to_integer(body)))
      assert Enum.sort(got) == Enum.to_list(1..50)
      :ok = Gnat.flush(gnat)
      refute_received {:member, _, _}
    end

    test "unsub ends a subscription", %{gnat: gnat, topic: topic} do
      {:ok, sid} = Gnat.sub(gnat, self(), topic)
      :ok = Gnat.unsub(gnat, sid)
      :ok = Gnat.pub(gnat, topic, "x")
      :ok = Gnat.flush(gnat)
      refute_received {:msg, _}
      assert :ok = Gnat.unsub(gnat, sid)
      assert :ok = Gnat.unsub(gnat, 4711)
    end

    test "subscriptions end with their process", %{gnat: gnat, topic: topic} do
      subscriber = spawn(fn -> receive(do: (:stop -> :ok)) end)
      {:ok, _} = Gnat.sub(gnat, subscriber, topic)
      {:ok, _} = Gnat.sub(gnat, subscriber, topic <> ".more")
      assert {:ok, 3} = Gnat.active_subscriptions(gnat)
      ref = Process.monitor(subscriber)
      send(subscriber, :stop)
      assert_receive {:DOWN, ^ref, _, _, _}
      eventually(fn -> Gnat.active_subscriptions(gnat) == {:ok, 1} end)
    end

    test "an invalid subject is refused before it is sent", %{gnat: gnat} do
      for subject <- ["", "a b", "a\r\nPUB b 0\r\n", "a\t", String.duplicate("x", 1025), :atom, nil] do
        assert {:error, %Error{reason: {:invalid_subject, ^subject}}} = Gnat.pub(gnat, subject, "")
        assert {:error, %Error{reason: {:invalid_subject, _}}} = Gnat.sub(gnat, self(), subject)
        assert {:error, %Error{reason: {:invalid_subject, _}}} = Gnat.request(gnat, subject, "")
      end

      assert {:error, %Error{reason: {:invalid_subject, _}}} = Gnat.pub(gnat, "a", "", reply_to: "b c")
      assert {:error, %Error{reason: {:invalid_subject, _}}} = Gnat.sub(gnat, self(), "a", queue_group: "b c")
      assert {:ok, 1} = Gnat.active_subscriptions(gnat)
    end

    test "a message that is too large is refused and the connection lives", %{gnat: gnat, topic: topic} do
      body = :binary.copy("x", 1_048_577)

      assert {:error, %Error{reason: {:payload_too_large, 1_048_577, 1_048_576}}} =
               Gnat.pub(gnat, topic, body)

      assert {:error, %Error{reason: {:payload_too_large, _, _}}} = Gnat.request(gnat, topic, body)
      {:ok, _} = Gnat.sub(gnat, self(), topic)
      :ok = Gnat.pub(gnat, topic, binary_part(body, 0, 1_048_576))
      assert_receive {:msg, %{body: body}} when byte_size(body) == 1_048_576
    end

    defp forward_all(test, n) do
      receive do
        {:msg, %{body: body}} -> send(test, {:member, n, body})
      end

      forward_all(test, n)
    end
  end

  describe "headers" do
    test "arrive in order, names in lower case", %{gnat: gnat, topic: topic} do
      {:ok, sid} = Gnat.sub(gnat, self(), topic)
      headers = [{"X-One", "1"}, {"x-two", "a: b "}, {"X-One", "again"}, {"Empty", ""}]
      :ok = Gnat.pub(gnat, topic, "body", headers: headers, reply_to: "back")

      assert_receive {:msg, message}

      assert %{body: "body", reply_to: "back", sid: ^sid, status: nil, description: nil, topic: ^topic} =
               message

      assert message.headers == [{"x-one", "1"}, {"x-two", "a: b"}, {"x-one", "again"}, {"empty", ""}]
    end

    test "that would forge others are refused", %{gnat: gnat, topic: topic} do
      for header <- [{"a\r\nb", "c"}, {"a", "b\r\nc: d"}, {"a:", "b"}, {"", "b"}, {"a b", "c"}] do
        assert {:error, %Error{reason: {:invalid_header, ^header}}} =
                 Gnat.pub(gnat, topic, "", headers: [header])

        assert {:error, %Error{reason: {:invalid_header, _}}} =
                 Gnat.request(gnat, topic, "", headers: [header])
      end
    end

    test "count for the size of a message", %{gnat: gnat, topic: topic} do
      body = :binary.copy("x", 1_048_576)

      assert {:error, %Error{reason: {:payload_too_large, _, _}}} =
               Gnat.pub(gnat, topic, body, headers: [{"a", "b"}])
    end

    test "of another client that are invalid do no harm", %{server: server, gnat: gnat, topic: topic} do
      {:ok, _} = Gnat.sub(gnat, self(), topic)
      :ok = Gnat.flush(gnat)
      {:ok, raw} = :gen_tcp.connect(~c"127.0.0.1", NatsServer.port(server), [:binary, active: false])
      block = "GARBAGE\r\nno colon\r\nGood: 1\r\n\r\n"
      size = byte_size(block)
      connect = "CONNECT {\"verbose\":false,\"headers\":true}\r\n"
      :ok = :gen_tcp.send(raw, [connect, "HPUB #{topic} #{size} #{size + 2}\r\n", block, "hi\r\n"])
      assert_receive {:msg, %{body: "hi", headers: [{"good", "1"}]}}
    end
  end

  describe "requests" do
    setup %{gnat: gnat, topic: topic} do
      echo = spawn_link(fn -> echo() end)
      {:ok, _} = Gnat.sub(gnat, echo, topic)
      :ok
    end

    test "get an answer", %{gnat: gnat, topic: topic} do
      assert {:ok, %{body: "hello", gnat: ^gnat, reply_to: nil}} = Gnat.request(gnat, topic, "hello")
    end

    test "with headers", %{gnat: gnat, topic: topic} do
      assert {:ok, %{headers: [{"x", "1"}]}} = Gnat.request(gnat, topic, "hi", headers: [{"X", "1"}])
    end

    test "from many processes get each their own answer", %{gnat: gnat, topic: topic} do
      1..100
      |> Task.async_stream(fn n -> {n, Gnat.request(gnat, topic, "#{n}")} end,
        max_concurrency: 20,
        timeout: 60_000
      )
      |> Enum.each(fn {:ok, {n, {:ok, %{body: body}}}} -> assert body == "#{n}" end)
    end

    test "without a subscriber: an error at once with no_responders", %{gnat: gnat} do
      assert {:error, :no_responders} = Gnat.request(gnat, unique("nobody"), "x")
    end

    test "without a subscriber: a timeout otherwise", %{server: server} do
      {:ok, gnat} = Gnat.start_link(NatsServer.settings(server))
      assert {:error, :timeout} = Gnat.request(gnat, unique("nobody"), "x", receive_timeout: 20)
    end

    test "a late answer is dropped", %{gnat: gnat} do
      topic = unique("late")
      {:ok, _} = Gnat.sub(gnat, self(), topic)
      assert {:error, :timeout} = Gnat.request(gnat, topic, "x", receive_timeout: 20)
      assert_receive {:msg, %{reply_to: inbox}}
      :ok = Gnat.pub(gnat, inbox, "late")
      :ok = Gnat.flush(gnat)
      refute_received _anything
    end

    test "of a process that dies are forgotten", %{gnat: gnat} do
      topic = unique("dying")
      {:ok, _} = Gnat.sub(gnat, self(), topic)
      {pid, ref} = spawn_monitor(fn -> Gnat.request(gnat, topic, "x") end)
      assert_receive {:msg, %{reply_to: inbox}}
      Process.exit(pid, :kill)
      assert_receive {:DOWN, ^ref, _, _, _}
      eventually(fn -> :sys.get_state(gnat, 60_000).session.requests == %{} end)
      :ok = Gnat.pub(gnat, inbox, "for nobody")
      assert :ok = Gnat.flush(gnat)
    end

    defp echo do
      receive do
        {:msg, %{reply_to: to, body: body, gnat: gnat} = message} ->
          opts = if message[:headers], do: [headers: message.headers], else: []
          Gnat.pub(gnat, to, body, opts)
      end

      echo()
    end
  end

  describe "pub_all/2" do
    test "publishes each message in its order, and gives each its result", %{gnat: gnat, topic: topic} do
      {:ok, _} = Gnat.sub(gnat, self(), topic)
      large = :binary.copy("x", 1_048_577)
      messages = [{topic, "1"}, {"not one", "2"}, {topic, large}, {topic, ["4"]}]

      assert [:ok, {:error, %Error{reason: {:invalid_subject, "not one"}}}, {:error, too_large}, :ok] =
               Gnat.pub_all(gnat, messages)

      assert too_large == Error.new({:payload_too_large, 1_048_577, 1_048_576})
      assert_receive {:msg, %{body: "1"}}
      assert_receive {:msg, %{body: "4"}}
      assert Gnat.pub_all(gnat, []) == []
      assert [{:error, %Error{}}] = Gnat.pub_all(gnat, [{"not one", "2"}])
    end

    test "of many processes at once loses and mixes nothing", %{gnat: gnat, topic: topic} do
      {:ok, _} = Gnat.sub(gnat, self(), topic)

      1..100
      |> Task.async_stream(fn n -> Gnat.pub_all(gnat, for(m <- 1..5, do: {topic, "#{n} #{m}"})) end,
        max_concurrency: 100
      )
      |> Enum.each(&assert(&1 == {:ok, List.duplicate(:ok, 5)}))

      for n <- 1..100 do
        assert for(_ <- 1..5, do: next("#{n} ")) == for(m <- 1..5, do: "#{n} #{m}")
      end
    end

    test "without a connection is an error of each", %{gnat: gnat} do
      :ok = Gnat.stop(gnat)
      error = {:error, Error.new(:not_connected)}
      assert Gnat.pub_all(gnat, [{"a", "b"}, {"c", "d"}]) == [error, error]
    end

    defp next(prefix) do
      size = byte_size(prefix)
      assert_receive {:msg, %{body: <<^prefix::binary-size(^size), _rest::binary>> = body}}
      body
    end
  end

  describe "the end of a connection" do
    test "stop/1 closes it, twice is fine", %{gnat: gnat} do
      assert :ok = Gnat.stop(gnat)
      refute Process.alive?(gnat)
      assert :ok = Gnat.stop(gnat)
    end

    test "afterwards every call is an error that says so, and nothing exits", %{gnat: gnat} do
      :ok = Gnat.stop(gnat)
      error = {:error, Error.new(:not_connected)}
      assert Gnat.pub(gnat, "a", "b") == error
      assert Gnat.sub(gnat, self(), "a") == error
      assert Gnat.unsub(gnat, 1) == error
      assert Gnat.request(gnat, "a", "b") == error
      assert Gnat.active_subscriptions(gnat) == error
      assert Gnat.flush(gnat) == error
      assert Gnat.pub(:nobody_has_this_name, "a", "b") == error
      assert Gnat.request(:nobody_has_this_name, "a", "b") == error
    end

    test "a waiting request ends with an error", %{gnat: gnat} do
      topic = unique("waiting")
      {:ok, _} = Gnat.sub(gnat, self(), topic)
      task = Task.async(fn -> Gnat.request(gnat, topic, "x") end)
      assert_receive {:msg, _}
      :ok = Gnat.stop(gnat)
      assert Task.await(task, 60_000) == {:error, Error.new(:not_connected)}
    end

    test "a server that lives but answers nothing is given up" do
      Process.flag(:trap_exit, true)
      server = start_supervised!(NatsServer, id: :frozen)
      {:ok, gnat} = Gnat.start_link(NatsServer.settings(server, %{ping_interval: 30}))
      :ok = NatsServer.freeze(server)
      assert_receive {:EXIT, ^gnat, {:shutdown, %Error{reason: :unresponsive}}}
    end

    test "a server that is killed" do
      Process.flag(:trap_exit, true)
      server = start_supervised!(NatsServer, id: :killed)
      {:ok, gnat} = Gnat.start_link(NatsServer.settings(server))
      :ok = NatsServer.kill(server)
      assert_receive {:EXIT, ^gnat, {:shutdown, %Error{reason: reason}}}
      assert reason == :closed or match?({:transport, _}, reason)
    end
  end
end
