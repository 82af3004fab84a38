defmodule MavRouter.Link.Transport.MspShareTest do
  @moduledoc "Programs that share a vehicle with MSP by the port of its link: their replies, the policy, what is not MSP, and a port that is taken."
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Frame
  alias MavRouter.Link

  @patience Aerie.Patience.ms()

  # Lets calibrations through, and nothing else; tells the test what it was asked.
  defmodule Calibrations do
    @behaviour MavRouter.Router.Policy

    @impl MavRouter.Router.Policy
    def principal(_gateway, path), do: %Aerie.Base.Principal{kind: :client, name: path.owner, may: []}
    @impl MavRouter.Router.Policy
    def permits?(_gateway, _principal, _vehicle), do: true
    @impl MavRouter.Router.Policy
    def open?(_gateway, _principal, _message), do: false

    @impl MavRouter.Router.Policy
    def decide(gateway, sender, vehicle, frame) do
      {:ok, message} = MavCodec.decode(frame)
      send(:persistent_term.get({__MODULE__, gateway}), {:asked, sender, vehicle, message})
      if match?(%M.CommandLong{command: 241}, message), do: :forward, else: {:refuse, [], nil}
    end
  end

  # A flight controller at a TCP port.
  defp controller do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}])

    answer =
      Msp.Test.Controller.betaflight(%{
        "ACC_CALIBRATION" => :done,
        "PID" => "$M>" <> <<3, 112, 1, 2, 3, 115>>
      })

    start_supervised!({Task, fn -> serve(listener, answer) end})
    {:ok, port} = :inet.port(listener)
    port
  end

  defp serve(listener, answer) do
    {:ok, socket} = :gen_tcp.accept(listener)
    read(socket, answer)
    serve(listener, answer)
  end

  defp read(socket, answer) do
    with {:ok, bytes} <- :gen_tcp.recv(socket, 0) do
      {frames, _parser} = MavCodec.Msp.Parser.push(MavCodec.Msp.Parser.new(), bytes)
      for frame <- frames, reply = answer.(Frame.encode(frame), 0), do: :ok = :gen_tcp.send(socket, reply)
      read(socket, answer)
    end
  end

  defp free_port do
    {:ok, listener} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(listener)
    :gen_tcp.close(listener)
    port
  end

  defp program(port) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false], @patience)
    socket
  end

  defp ask(socket, id, payload \\ "") do
    :ok = :gen_tcp.send(socket, Frame.encode(%Frame{id: id, payload: payload}))
    {:ok, bytes} = :gen_tcp.recv(socket, 0, @patience)
    {[frame], _parser} = MavCodec.Msp.Parser.push(MavCodec.Msp.Parser.new(), bytes)
    frame
  end

  setup do
    gateway = start_parts(%{}, options: [policy: Calibrations])
    :persistent_term.put({Calibrations, gateway}, self())
    on_exit(fn -> :persistent_term.erase({Calibrations, gateway}) end)
    {:ok, gateway: gateway}
  end

  test "two programs get their replies; a write is judged as their client of the link's name", %{
    gateway: gateway
  } do
    share = free_port()
    {_id, _port} = add_link(gateway, "msp:tcp:127.0.0.1:#{controller()}?sysid=9&share=#{share}", id: "racer")
    eventually(fn -> MavRouter.Router.route(gateway, {"main", 9}) end)
    [one, two] = [program(share), program(share)]
    assert %{id: 2, payload: "BTFL", direction: :reply} = ask(one, 2)
    assert %{id: 112, payload: <<1, 2, 3>>} = ask(two, 112)
    assert %{id: 205, direction: :reply} = ask(one, 205)

    assert_receive {:asked,
                    %{owner: "racer-share", peer: "127.0.0.1:" <> _, principal: %{name: "racer-share"}},
                    {"main", 9}, %M.CommandLong{command: 241, target_system: 9}}

    assert %{id: 250, direction: :error} = ask(one, 250)
    assert_receive {:asked, _sender, _vehicle, %M.CommandLong{command: 245}}
    # A form of a page in a browser of this machine.
    web = program(share)
    :ok = :gen_tcp.send(web, "POST / HTTP/1.1\r\nHost: x\r\n\r\n" <> Frame.encode(%Frame{id: 205}))
    assert {:ok, "HTTP/1.1 400 Bad Request" <> _} = :gen_tcp.recv(web, 0, @patience)
    refute_received {:asked, _sender, _vehicle, %M.CommandLong{command: 241}}
    # One that is gone takes nothing with it.
    :gen_tcp.close(two)
    assert %{id: 2} = ask(one, 2)
    # There is room for eight; the connection of a later one is closed.
    last = Enum.at(for(_n <- 1..9, do: program(share)), -1)
    assert {:error, :closed} = :gen_tcp.recv(last, 0, @patience)
    assert %{id: 2} = ask(one, 2)
  end

  defp upgrade(port, headers) do
    socket = program(port)
    key = :cow_ws.key()

    request =
      "GET /msp HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: #{key}\r\n#{headers}\r\n"

    :ok = :gen_tcp.send(socket, request)
    {:ok, answer} = :gen_tcp.recv(socket, 0, @patience)
    {socket, key, answer}
  end

  test "a WebSocket: programs, and pages of the origin that is named; others are refused", %{gateway: gateway} do
    share = free_port()
    url = "msp:tcp:127.0.0.1:#{controller()}?sysid=9&share=#{share}&share_origin=https://app.example"
    {_id, _port} = add_link(gateway, url, id: "racer")
    eventually(fn -> MavRouter.Router.route(gateway, {"main", 9}) end)

    for headers <- ["", "Origin: https://app.example\r\nSec-WebSocket-Protocol: wsSerial, other\r\n"] do
      {socket, key, answer} = upgrade(share, headers)
      assert answer =~ "HTTP/1.1 101" and answer =~ :cow_ws.encode_key(key)
      assert answer =~ "Sec-WebSocket-Protocol: wsSerial" == (headers != "")
      request = Frame.encode(%Frame{id: 2})
      # A request in two messages, and a ping between.
      <<first::binary-size(3), second::binary>> = request
      :ok = :gen_tcp.send(socket, :cow_ws.masked_frame({:binary, first}, %{}))
      :ok = :gen_tcp.send(socket, :cow_ws.masked_frame({:ping, "hi"}, %{}))
      assert {:ok, <<0x8A, 2, "hi">>} = :gen_tcp.recv(socket, 0, @patience)
      :ok = :gen_tcp.send(socket, :cow_ws.masked_frame({:binary, second}, %{}))
      assert {:ok, <<0x82, size, "$M>", 4, 2, "BTFL", _>>} = :gen_tcp.recv(socket, 0, @patience)
      assert size == 10
      :ok = :gen_tcp.send(socket, :cow_ws.masked_frame(:close, %{}))
      assert {:error, :closed} = :gen_tcp.recv(socket, 0, @patience)
    end

    assert {socket, _key, "HTTP/1.1 403 Forbidden" <> _} = upgrade(share, "Origin: https://evil.example\r\n")
    assert {:error, :closed} = :gen_tcp.recv(socket, 0, @patience)
    # Not masked, as a client must not.
    {socket, _key, _answer} = upgrade(share, "")
    :ok = :gen_tcp.send(socket, :cow_ws.frame({:binary, Frame.encode(%Frame{id: 2})}, %{}))
    assert {:error, :closed} = :gen_tcp.recv(socket, 0, @patience)
  end

  test "a port that is taken costs the vehicle nothing, and is a warning", %{gateway: gateway} do
    {:ok, taken} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(taken)
    {_id, _port} = add_link(gateway, "msp:tcp:127.0.0.1:#{controller()}?sysid=9&share=#{port}", id: "racer")
    eventually(fn -> MavRouter.Router.route(gateway, {"main", 9}) end)
    assert Link.snapshot(gateway, "racer").status == :up
  end
end
