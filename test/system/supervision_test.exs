defmodule Aerie.System.SupervisionTest do
  @moduledoc """
  Every process that the gateway supervises is killed, one after the other, while a vehicle flies. The gateway stays up, the
  killed process is restarted, and the vehicle is heard again and is in NATS.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Base.Names

  @moduletag :tmp_dir
  # Killed processes are logged; the log is captured.
  @moduletag :capture_log

  # A gateway loses several of its own children, one after the other.
  @per_gateway 6

  test "every killed process, supervisors included, restarts without ending the gateway", %{tmp_dir: folder} do
    top = fly(folder, "survey").gateway |> top() |> children([]) |> Enum.uniq()
    assert length(top) == 18

    for {paths, n} <- top |> Enum.chunk_every(@per_gateway) |> Enum.with_index() do
      run = fly(folder, "top-#{n}")
      for path <- paths, do: kill(run.gateway, path)
    end
  end

  test "so do the processes further down", %{tmp_dir: folder} do
    %{gateway: gateway} = fly(folder, "deep")
    deeper = gateway |> top() |> paths([]) |> Enum.filter(&(length(&1) > 1))
    assert length(deeper) > 20

    for path <- deeper, do: kill(gateway, path)
  end

  defp kill(gateway, path) do
    top = top(gateway)
    victim = eventually(fn -> at(top, path) end, "#{inspect(path)} is there")
    heard = eventually(fn -> heard(gateway) end, "the vehicle is known")
    reference = Process.monitor(victim)
    Process.exit(victim, :kill)
    assert_receive {:DOWN, ^reference, :process, ^victim, _reason}

    eventually(
      fn ->
        assert Process.alive?(top), "the gateway ended when #{inspect(path)} was killed"

        # A temporary child (a client that left) may be gone for good, but its parent lives.
        (at(top, path) || at(top, Enum.drop(path, -1))) not in [nil, victim]
      end,
      "#{inspect(path)} is back"
    )

    eventually(
      fn -> (heard(gateway) || heard) > heard end,
      "the vehicle is heard after #{inspect(path)} was killed"
    )

    eventually(
      fn -> match?(%{connected: true}, info(gateway)) end,
      "NATS is connected after #{inspect(path)}"
    )

    assert Process.alive?(top)
  end

  defp fly(folder, name) do
    run = start_gateway(Path.join(folder, name), links: ["udpin:127.0.0.1:#{free_udp_port()}"])
    link = "udpout:127.0.0.1:#{link_port(run.gateway, "link-1")}"

    start_supervised!({SimVehicle, firmware: :ardupilot, system: 1, link: link, ready_s: 0.5},
      id: {:sim, name}
    )

    eventually(fn -> heard(run.gateway) end, "the vehicle is heard")
    run
  end

  # While the store restarts it has no tables.
  defp heard(gateway) do
    with %{last_heard: at} <- Store.vehicle(gateway, "VID-001"), do: at
  rescue
    ArgumentError -> nil
  end

  defp info(gateway) do
    Aerie.Fleet.Bridge.info(gateway)
  rescue
    ArgumentError -> nil
  catch
    :exit, _restarting -> nil
  end

  defp top(gateway), do: Names.whereis(gateway, :gateway)

  defp at(pid, []), do: pid

  defp at(supervisor, [id | rest]) do
    with {^id, pid, _type, _modules} when is_pid(pid) <- List.keyfind(which(supervisor), id, 0),
         do: at(pid, rest)
  end

  defp paths(supervisor, above) do
    for path <- children(supervisor, above), deeper <- [path | deeper(supervisor, path)], do: deeper
  end

  defp deeper(supervisor, path) do
    id = List.last(path)

    case List.keyfind(which(supervisor), id, 0) do
      {^id, pid, :supervisor, _modules} when is_pid(pid) -> paths(pid, path)
      _worker -> []
    end
  end

  # A dynamic supervisor's children have no ids; there is one of each here.
  defp children(supervisor, above),
    do: for({id, pid, _, _} <- which(supervisor), is_pid(pid), do: above ++ [id])

  defp which(supervisor) do
    Supervisor.which_children(supervisor)
  catch
    :exit, _gone -> []
  end
end
