defmodule MavRouter.Link.Transport.LinkLocalTest do
  @moduledoc "Link-local IPv6 addresses, which say nothing without their interface."
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias Aerie.Base.Net.Address
  alias MavRouter.Link
  alias MavRouter.Link.Transport.Net

  # An interface of this machine with such an address, if there is one.
  @own (case :net.getifaddrs(%{family: :inet6, flags: :any}) do
          {:ok, all} ->
            for %{name: name, addr: %{addr: {a, _, _, _, _, _, _, _} = address}} <- all,
                a in 0xFE80..0xFEBF,
                {:ok, number} <- [:net.if_name2index(name)],
                do: {Address.with_scope(elem(Address.scope(address), 0), number), "#{name}"}

          {:error, _none} ->
            []
        end)
       |> List.first()

  @moduletag skip: @own == nil && "no interface of this machine has a link-local address"

  setup do
    {:ok, gateway: start_parts()}
  end

  # A UDP socket of the other end, at our own address.
  defp vehicle do
    {address, _name} = @own
    {:ok, socket} = :socket.open(:inet6, :dgram, :udp)
    :ok = :socket.bind(socket, Net.sockaddr(address, 0))
    {:ok, %{port: port}} = :socket.sockname(socket)
    {socket, port}
  end

  defp host, do: @own |> elem(0) |> Address.format(0) |> String.replace_suffix(":0", "")

  defp heard(socket) do
    {:ok, {_from, bytes}} = :socket.recvfrom(socket, 0, [], Aerie.Patience.ms())
    bytes
  end

  test "a sender is answered by the interface by which it came", %{gateway: gateway} do
    {address, name} = @own
    {socket, own_port} = vehicle()

    for listen <- ["udpin:[::]:0", "udpin:#{host()}:0"] do
      {id, port} = add_link(gateway, listen)
      :ok = :socket.sendto(socket, heartbeat(1), Net.sockaddr(address, port))
      eventually(fn -> match?(%{peers: [_vehicle]}, snapshot(gateway, id)) end)
      assert [%{text: text}] = snapshot(gateway, id).peers
      assert text =~ "%#{name}]:#{own_port}"
      :ok = Link.send_bytes(gateway, id, "signed by the link", :all)
      assert heard(socket) == "signed by the link"
      # By any process, past the link's.
      eventually(fn -> MavRouter.Router.route(gateway, {"main", 1}) != nil end)
      :ok = MavRouter.Router.send(gateway, {"main", 1}, "from the router")
      assert heard(socket) == "from the router"
      :ok = Link.stop(gateway, id)
    end
  end

  test "a client by UDP and by TCP goes by the interface that it names", %{gateway: gateway} do
    {address, _name} = @own
    {socket, port} = vehicle()
    {id, _port} = add_link(gateway, "udpout:#{host()}:#{port}")
    :ok = Link.send_bytes(gateway, id, "hello", :all)
    {:ok, {from, bytes}} = :socket.recvfrom(socket, 0, [], Aerie.Patience.ms())
    assert bytes == "hello" or byte_size(bytes) > 5
    :ok = :socket.sendto(socket, heartbeat(1), from)
    eventually(fn -> snapshot(gateway, id).counters.frames_in == 1 end)

    {:ok, listener} = :gen_tcp.listen(0, [:inet6, Net.bind(address, 0)])
    {:ok, tcp_port} = :inet.port(listener)
    {id, _port} = add_link(gateway, "tcp:#{host()}:#{tcp_port}")
    eventually(fn -> snapshot(gateway, id).status == :up end)
  end

  test "an interface that there is not is the reason of a link that is down", %{gateway: gateway} do
    {:ok, id} = Link.start(gateway, "tcp:[fe80::1%nosuch0]:5760", wait: false)
    eventually(fn -> snapshot(gateway, id).status == :down end)
    assert snapshot(gateway, id).reason == "there is no interface nosuch0 for [fe80::1%nosuch0]"
  end
end
