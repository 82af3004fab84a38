defmodule MavRouter.Link.NamesTest do
  # Name resolution is global to the VM.
  use ExUnit.Case, async: false
  use Aerie.LinkCase

  alias MavRouter.Link

  @name "moves.aerie.test"

  setup do
    before = :inet_db.res_option(:lookup)
    :ok = :inet_db.set_lookup([:file | before])

    on_exit(fn ->
      :inet_db.set_lookup(before)
      for host <- [{127, 0, 0, 2}, {127, 0, 0, 3}], do: :inet_db.del_host(host)
    end)
  end

  defp move(from, to) do
    if from, do: :ok = :inet_db.del_host(from)
    :ok = :inet_db.add_host(to, [String.to_charlist(@name)])
  end

  test "a name is resolved for each connection: a peer that moved is found" do
    gateway = start_parts()
    move(nil, {127, 0, 0, 2})
    {:ok, first} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 2}, active: false])
    {:ok, port} = :inet.port(first)
    {:ok, second} = :gen_tcp.listen(port, [:binary, ip: {127, 0, 0, 3}, active: false])
    {:ok, id} = Link.start(gateway, "tcp:#{@name}:#{port}")
    {:ok, connection} = :gen_tcp.accept(first, Aerie.Patience.ms())
    eventually(fn -> snapshot(gateway, id).status in [:up, :idle] end)

    move({127, 0, 0, 2}, {127, 0, 0, 3})
    :ok = :gen_tcp.close(first)
    :ok = :gen_tcp.close(connection)
    assert {:ok, _there} = :gen_tcp.accept(second, Aerie.Patience.ms())
  end
end
