defmodule Aerie.Api.ListenerTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 2]

  alias Aerie.Api.Listener

  @moduletag :capture_log

  test "a listener answers again after any of its processes was killed" do
    ref = make_ref()
    dispatch = :cowboy_router.compile([{:_, []}])
    limits = %{socket_opts: [ip: {127, 0, 0, 1}, port: 0], num_acceptors: 2, num_conns_sups: 1}

    top =
      start_supervised!({Listener, {ref, :ranch_tcp, limits, :cowboy_clear, %{env: %{dispatch: dispatch}}}})

    eventually(fn -> answers?(ref) end, "it answers")

    for n <- 0..(length(below(top)) - 1) do
      victim = eventually(fn -> Enum.at(below(top), n) end, "process #{n} is there")
      monitor = Process.monitor(victim)
      Process.exit(victim, :kill)
      assert_receive {:DOWN, ^monitor, :process, ^victim, _reason}
      eventually(fn -> answers?(ref) end, "it answers after process #{n}, #{inspect(victim)}, was killed")
    end
  end

  defp below(supervisor) do
    for {_id, pid, type, modules} when is_pid(pid) <- Supervisor.which_children(supervisor),
        # The connections come and go.
        pid <- [pid | if(type == :supervisor and modules != [:ranch_conns_sup], do: below(pid), else: [])],
        do: pid
  catch
    :exit, _gone -> []
  end

  defp answers?(ref) do
    with {:ok, socket} <- :gen_tcp.connect({127, 0, 0, 1}, Listener.port_of(ref), [:binary, active: false]) do
      _ = :gen_tcp.send(socket, "GET / HTTP/1.0\r\n\r\n")
      answer = :gen_tcp.recv(socket, 0, Aerie.Patience.ms())
      :gen_tcp.close(socket)
      match?({:ok, "HTTP/1.1 404" <> _}, answer)
    else
      _closed -> false
    end
  rescue
    _restarting -> false
  end
end
