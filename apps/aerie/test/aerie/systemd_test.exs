defmodule Aerie.SystemdTest do
  use ExUnit.Case, async: true

  alias Aerie.{GatewayCase, ShortDir, Systemd}
  alias Aerie.Base.Names

  @moduletag :capture_log

  # What systemd is: a datagram socket in a folder.
  defp listen do
    path = Path.join(ShortDir.new(), "notify")
    {:ok, socket} = :gen_udp.open(0, [:local, :binary, active: true, ip: {:local, path}])
    {socket, path}
  end

  defp start(gateway, environment),
    do: start_supervised!({Systemd, gateway: gateway, environment: environment})

  defp await(socket, text) do
    receive do
      {:udp, ^socket, _from, _port, message} -> if message =~ text, do: message, else: await(socket, text)
    after
      Aerie.Patience.ms() -> flunk("never told #{text}")
    end
  end

  test "it says that it is ready, feeds the watchdog while the tree is alive, and says that it ends" do
    gateway = GatewayCase.start_gateway(%{}, with: [:router, :links])
    {socket, path} = listen()
    pid = start(gateway, %{"NOTIFY_SOCKET" => path, "WATCHDOG_USEC" => "200000"})
    assert await(socket, "") == "READY=1\n"
    assert await(socket, "WATCHDOG=1") =~ "STATUS=0 vehicles online, 0 links open"
    await(socket, "WATCHDOG=1")

    # A process that the heartbeat needs is stuck: no word to the watchdog, and the reason.
    stuck = Names.whereis(gateway, :pubsub)
    :ok = :sys.suspend(stuck, Aerie.Patience.ms())
    assert await(socket, "does not answer: pubsub") =~ ~r/\ASTATUS=does not answer: pubsub\n/
    :ok = :sys.resume(stuck, Aerie.Patience.ms())
    await(socket, "WATCHDOG=1")

    monitor = Process.monitor(pid)
    stop_supervised!(Systemd)
    assert_receive {:DOWN, ^monitor, :process, _pid, _reason}
    assert await(socket, "STOPPING=1") =~ "ending"
  end

  test "a gateway whose supervisor is gone does not feed it" do
    assert {false, "does not answer: supervisor"} = Systemd.condition(make_ref())
  end

  test "without a service manager it does not run; one that does not listen harms nothing" do
    assert Systemd.start_link(gateway: make_ref(), environment: %{}) == :ignore
    gateway = make_ref()
    pid = start(gateway, %{"NOTIFY_SOCKET" => "@aerie-nobody-#{System.unique_integer([:positive])}"})
    assert %{gateway: ^gateway} = :sys.get_state(pid, Aerie.Patience.ms())
  end
end
