defmodule Gnat.HandshakeTest do
  # Against a server made of a socket: what a real one never says, or only on a bad day.
  use ExUnit.Case, async: true

  alias Gnat.Error

  setup do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, port} = :inet.port(listener)
    {:ok, listener: listener, settings: %{host: "127.0.0.1", port: port, connection_timeout: 60_000}}
  end

  # Plays the script: text to send, :recv for something to be read first, :close.
  defp connect(%{listener: listener, settings: settings}, script) do
    spawn_link(fn ->
      {:ok, socket} = :gen_tcp.accept(listener)

      for step <- script do
        case step do
          :recv -> {:ok, _} = :gen_tcp.recv(socket, 0)
          :close -> :gen_tcp.close(socket)
          text -> :gen_tcp.send(socket, text)
        end
      end

      receive do: (:never -> :ok)
    end)

    Gnat.start_link(settings)
  end

  test "INFO may come in pieces, a second one and +OK before the PONG", context do
    script = [
      "INF",
      "O {\"headers\":true,\"max_payload\":9}\r",
      "\n",
      :recv,
      "+OK\r\nPING\r\nINFO {\"ldm\":true}\r\n",
      "PONG\r\n"
    ]

    assert {:ok, gnat} = connect(context, script)
    assert %{ldm: true} = Gnat.server_info(gnat)
  end

  test "bytes behind the PONG are read by the connection", context do
    assert {:ok, gnat} =
             connect(context, ["INFO {\"headers\":true}\r\n", :recv, "PONG\r\nINF", "O {\"ldm\":true}\r\n"])

    Gnat.Test.eventually(fn -> match?(%{ldm: true}, Gnat.server_info(gnat)) end)
  end

  test "bytes that come together with the PONG are read too", context do
    assert {:ok, gnat} =
             connect(context, [
               "INFO {\"headers\":true}\r\n",
               :recv,
               "PONG\r\nINFO {\"ldm\":true}\r\nPING\r\n"
             ])

    assert %{ldm: true} = Gnat.server_info(gnat)
  end

  test "a server without headers refuses only messages with headers", context do
    assert {:ok, gnat} = connect(context, ["INFO {}\r\n", :recv, "PONG\r\n"])
    assert :ok = Gnat.pub(gnat, "a", "b")
    assert {:error, %Error{reason: :headers_not_supported}} = Gnat.pub(gnat, "a", "b", headers: [{"c", "d"}])

    assert {:error, %Error{reason: :headers_not_supported}} =
             Gnat.request(gnat, "a", "b", headers: [{"c", "d"}])
  end

  test "every other course is an error", context do
    for {script, reason} <- [
          {[:close], :closed},
          {["-ERR 'maximum connections exceeded'\r\n"], {:server, "maximum connections exceeded"}},
          {["PING\r\n"], {:protocol, "the server does not begin with INFO"}},
          {["INFO {}\r\n", :recv, :close], :closed},
          {["INFO {}\r\n", :recv, "-ERR 'Authentication Timeout'\r\n", :close],
           {:auth, "Authentication Timeout"}},
          {["INFO {}\r\n", :recv, "-ERR 'something'\r\nnonsense\r\n"], {:server, "something"}},
          {["INFO {}\r\n", :recv, "nonsense\r\n"], {:protocol, "unknown command \"nonsense\""}},
          {["INFO {}\r\n", :recv, "MSG a 1 0\r\n\r\n"], {:protocol, "a message before the answer to CONNECT"}}
        ] do
      assert {:error, %Error{reason: ^reason}} = connect(context, script)
    end
  end

  test "garbage ends the connection with a description of it", context do
    Process.flag(:trap_exit, true)
    assert {:ok, gnat} = connect(context, ["INFO {}\r\n", :recv, "PONG\r\n", :recv, "PING\r\nnonsense\r\n"])
    assert_receive {:EXIT, ^gnat, {:shutdown, %Error{reason: {:protocol, "unknown command \"nonsense\""}}}}
  end

  test "the server's last error is the reason of the end", context do
    Process.flag(:trap_exit, true)
    script = ["INFO {}\r\n", :recv, "PONG\r\n", :recv, "-ERR 'Slow Consumer'\r\n", :close]

    ExUnit.CaptureLog.capture_log(fn ->
      assert {:ok, gnat} = connect(context, script)
      assert_receive {:EXIT, ^gnat, {:shutdown, %Error{reason: {:server, "Slow Consumer"}}}}
    end)
  end
end
