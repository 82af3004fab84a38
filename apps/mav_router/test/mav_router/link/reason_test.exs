defmodule MavRouter.Link.ReasonTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Net.PortOwner
  alias MavRouter.Link.Reason
  alias MavRouter.Link.Server.Restarts
  alias MavRouter.Link.Spec

  defp words(reason, text), do: Reason.format(reason, Spec.parse!(text))

  test "faults in words, with the place" do
    assert words(:econnrefused, "tcp:[::1]:5760") == "connection refused by [::1]:5760"
    assert words(:timeout, "tcp:10.0.0.1:5760") == "no answer from 10.0.0.1:5760"
    assert words(:nxdomain, "tcp:nowhere.invalid:1") == "the name of nowhere.invalid:1 cannot be resolved"
    assert words(:enoent, "/dev/ttyACM0,57600") == "there is no /dev/ttyACM0"

    assert words(:eacces, "/dev/ttyACM0") ==
             "no permission for /dev/ttyACM0 (is the user in the group dialout?)"

    asked = {GenServer, :call, [self(), {:open, "/dev/ttyACM0", 57_600}, 20_000]}
    assert words({:timeout, asked}, "/dev/ttyACM0,57600") == "opening /dev/ttyACM0 takes too long"

    assert words(:eacces, "udpin::14") == "no permission for 0.0.0.0:14 (ports below 1024 need root)"
    assert words(:eaddrnotavail, "udpin:10.9.8.7:1") == "10.9.8.7:1 is not an address of this machine"
    assert words({:shutdown, :closed}, "tcp:1.2.3.4:5") == "connection closed by 1.2.3.4:5"
    assert words({:in_use, "x (process 7)"}, "udpin::1") == "0.0.0.0:1 is in use by x (process 7)"
    assert words("as it is", "udpin::1") == "as it is"
  end

  test "every POSIX error has words, also those that we do not name; anything else is inspected" do
    for reason <- [:epipe, :ehostdown, :enospc, :no_such_error, :eio, :ebusy, :emfile, :econnreset, :enetdown] do
      text = words(reason, "tcp:1.2.3.4:5")
      assert text =~ " "
      refute text =~ "unknown POSIX"
    end

    assert words({:weird, [1]}, "tcp:1.2.3.4:5") == "1.2.3.4:5 failed: {:weird, [1]}"
  end

  test "waits in words" do
    assert Reason.wait(0) == "now"
    assert Reason.wait(3_249) == "in 3.2 s"
  end

  test "the owner of a port is found; a free port has none" do
    {:ok, udp} = :gen_udp.open(0, [])
    {:ok, tcp} = :gen_tcp.listen(0, [:inet6])
    {:ok, udp_port} = :inet.port(udp)
    {:ok, tcp_port} = :inet.port(tcp)
    pid = String.to_integer(System.pid())
    assert {:ok, _name, ^pid} = PortOwner.find(:udp, udp_port)
    assert {:ok, _name, ^pid} = PortOwner.find(:tcp, tcp_port)
    :gen_udp.close(udp)
    assert PortOwner.find(:udp, udp_port) == :unknown
  end

  test "a crashing link waits ever longer before it connects, and never so long that it is not back within a second" do
    {waits, _restarts} =
      Enum.map_reduce(1..30, nil, fn n, restarts ->
        restarts = Restarts.add(restarts, n)
        {Restarts.wait(restarts), restarts}
      end)

    assert Enum.take(waits, 6) == [0, 0, 0, 0, 50, 100]
    assert Enum.max(waits) == 500
    assert Restarts.wait(Restarts.add(Enum.to_list(1..10), 10_000)) == 0
  end
end
