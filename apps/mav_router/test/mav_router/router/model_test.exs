defmodule MavRouter.Router.ModelTest do
  @moduledoc """
  The router against a plain model of the rules: sets of who was heard where, and from them who gets a frame (R1, R2, R4,
  R6, R9, F10). Frames are said by all kinds of endpoints in any order, endpoints come and go, systems reboot.
  """
  use Aerie.LinkCase, async: true

  alias MavRouter.Router
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Tables
  alias MavCodec.Messages, as: M

  @moduletag capture_log: true

  # Who is on which side, and which networks it sees; "c-3" listens to everything of its networks.
  @ends %{
    "v-1" => {:vehicle, ["red"], false},
    "v-2" => {:vehicle, ["red"], false},
    "v-3" => {:vehicle, ["blue"], false},
    "c-1" => {:client, ["red"], false},
    "c-2" => {:client, ["blue", "red"], false},
    "c-3" => {:client, ["red", "blue"], true}
  }
  @names Map.keys(@ends)

  defp attach(gateway, name) do
    {side, networks, sniffer} = @ends[name]
    tables = Tables.of(gateway)
    {:ok, owner} = Owner.new(name, side: side, networks: networks, sniffer: sniffer)
    Endpoints.put_owner(tables, owner)
    endpoint = Endpoint.new(gateway, {name, :self}, out: {:pid, self(), name}, kind: :test)
    Endpoints.put(gateway, tables, endpoint)
  end

  ## What happens

  defp op do
    :proper_types.frequency([
      {20, {:say, :proper_types.oneof(@names), source(), target()}},
      {1, {:leave, :proper_types.oneof(@names)}},
      {1, {:reboot, :proper_types.oneof(["red", "blue"]), :proper_types.range(1, 3)}}
    ])
  end

  # Vehicles have the ids 1 to 3 on both networks, clients 201 and 202.
  defp source, do: {:proper_types.oneof([1, 2, 3, 201, 202]), :proper_types.oneof([1, 100])}

  defp target do
    :proper_types.oneof([
      :none,
      :unknown,
      {0, :proper_types.oneof([0, 1])},
      {:proper_types.oneof([1, 2, 3, 9, 201, 202]), :proper_types.oneof([0, 1, 100, 155])}
    ])
  end

  ## The model: `%{{network, system, component} => endpoints}`

  defp learn(routes, name, {system, component}) do
    {_side, networks, _sniffer} = @ends[name]

    Enum.reduce(networks, routes, fn network, routes ->
      Map.update(routes, {network, system, component}, MapSet.new([name]), &MapSet.put(&1, name))
    end)
  end

  defp by_component(routes, network, {system, component}),
    do: routes |> Map.get({network, system, component}, MapSet.new()) |> MapSet.to_list()

  defp by_system(routes, network, system) do
    for({{^network, ^system, _component}, names} <- routes, name <- names, do: name) |> Enum.uniq()
  end

  defp side(name), do: elem(@ends[name], 0)
  defp networks(name), do: elem(@ends[name], 1)
  defp sniffer?(name), do: elem(@ends[name], 2)
  defp shared?(a, b), do: Enum.any?(networks(a), &(&1 in networks(b)))

  # Not to the one who said it, nor to it by another of its radios.
  defp itself?(routes, from, source, to) do
    side(to) == :vehicle and Enum.any?(networks(from), &(to in by_component(routes, &1, source)))
  end

  # Of two systems of one id the one on the network that is named first is seen.
  defp sees?(routes, from, {system, _component}, to) do
    case Enum.split_while(networks(to), &(&1 not in networks(from))) do
      {_all, []} ->
        false

      {[], _shared} ->
        true

      {earlier, _shared} ->
        side(from) == :client or Enum.all?(earlier, &(by_system(routes, &1, system) == []))
    end
  end

  defp expected(routes, from, source, target) when target in [:none, :unknown] or elem(target, 0) == 0 do
    for to <- @names,
        to != from,
        # Telemetry, and what nobody knows, is not for vehicles.
        side(to) == :client or target not in [:none, :unknown],
        sees?(routes, from, source, to),
        not itself?(routes, from, source, to),
        do: to
  end

  defp expected(routes, from, source, {system, component} = target) do
    ways =
      Enum.find_value(networks(from), [], fn network ->
        exact = if component == 0, do: [], else: by_component(routes, network, target)
        ways = if exact == [], do: by_system(routes, network, system), else: exact
        if ways != [], do: ways
      end)

    heard = for to <- ways, to != from, not itself?(routes, from, source, to), do: to
    sniffers = for to <- @names, sniffer?(to), to != from, to not in ways, shared?(from, to), do: to
    heard ++ sniffers
  end

  ## The real one

  defp bytes({system, component}, target, n) do
    options = [system: system, component: component, seq: rem(n, 256)]

    case target do
      :none -> MavCodec.encode(%M.Attitude{time_boot_ms: n}, options)
      :unknown -> <<0xFD, 4, 0, 0, rem(n, 256), system, component, 0xABCDEF::24-little, n::32, 1, 2>>
      {system, component} -> param(system, component, n, options)
    end
  end

  defp param(system, component, n, options) do
    set = %M.ParamSet{target_system: system, target_component: component, param_id: "N", param_value: n * 1.0}
    MavCodec.encode(set, options)
  end

  defp say(gateway, name, bytes) do
    {frames, _} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, 5)
    Aerie.Reader.deliver(gateway, %{id: name, network: hd(networks(name)), peer: :self}, frames)
  end

  defp got(bytes) do
    receive do
      {:forward, name, [^bytes], _class} -> [name | got(bytes)]
      {:forward, _name, _other, _class} = wrong -> [wrong]
    after
      0 -> []
    end
  end

  defp step({:say, from, source, target}, {gateway, routes, n, :ok}) do
    # What is not understood teaches nothing (R4).
    routes = if target == :unknown, do: routes, else: learn(routes, from, source)
    # Who learned what is seen by the others within a second; here nobody waits for that.
    Tables.rerouted(Tables.of(gateway))
    bytes = bytes(source, target, n)
    say(gateway, from, bytes)

    case {Enum.sort(got(bytes)), Enum.sort(expected(routes, from, source, target))} do
      {same, same} -> {gateway, routes, n + 1, :ok}
      {got, expected} -> {gateway, routes, n, {:wrong, {from, source, target}, got: got, expected: expected}}
    end
  end

  # An endpoint that goes takes its routes along; one of that name comes again.
  defp step({:leave, name}, {gateway, routes, n, :ok}) do
    Endpoints.remove(Tables.of(gateway), {name, :self})
    attach(gateway, name)
    {gateway, Map.new(routes, fn {key, names} -> {key, MapSet.delete(names, name)} end), n, :ok}
  end

  defp step({:reboot, network, system}, {gateway, routes, n, :ok}) do
    :ok = gateway |> MavRouter.Tables.of() |> MavRouter.Routes.forget_system({network, system}, :_, :_)
    {gateway, Map.reject(routes, &match?({{^network, ^system, _component}, _names}, &1)), n, :ok}
  end

  defp step(_op, wrong), do: wrong

  test "every frame goes to those whom the rules say (R1, R2, R4, R6, R9, F10)" do
    property =
      :proper.forall(:proper_types.list(op()), fn ops ->
        gateway = start_parts(%{router: %{between_vehicles: :all}})
        for name <- @names, do: attach(gateway, name)
        {_gateway, _routes, _n, result} = Enum.reduce(ops, {gateway, %{}, 0, :ok}, &step/2)

        for module <- [
              MavRouter.Link.Supervisor,
              MavRouter.Identity.Watchdog,
              Router.Supervisor,
              Aerie.Base.PubSub,
              Aerie.Base.Store
            ],
            do: stop_supervised!({module, gateway})

        Process.delete({Aerie.Reader, gateway})
        if result != :ok, do: IO.inspect(result, label: "after #{length(ops)}")
        result == :ok
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 60, max_size: 60]) == true,
           inspect(:proper.counterexample())
  end
end
