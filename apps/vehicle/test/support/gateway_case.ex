defmodule Aerie.GatewayCase do
  @moduledoc """
  Tests that need a gateway of their own: `start_gateway/1` gives its name. All are async; nothing is shared.
  """
  use ExUnit.CaseTemplate

  using do
    quote do
      import Aerie.GatewayCase
    end
  end

  @parts [
    {:always, Aerie.Base.Store},
    {:always, Aerie.Base.PubSub},
    {:always, MavRouter.Signing.Supervisor},
    {:always, MavRouter.Recorder.Supervisor},
    {:router, MavRouter.Router.Supervisor},
    {:always, Aerie.Vehicle.Supervisor},
    {:links, MavRouter.Link.Supervisor}
  ]

  # Modules of higher apps with functions `parts` and `plugs`; test_helper.exs of an app names them.
  defp above, do: Application.get_env(:vehicle, :gateway_parts, [])

  defp parts(kinds) do
    all =
      for module <- above(), {kind, part, before} <- module.parts(), reduce: @parts do
        parts ->
          at = Enum.find_index(parts, fn {_kind, other} -> other == before end) || length(parts)
          List.insert_at(parts, at, {kind, part})
      end

    for {kind, part} <- all, kind in [:always | kinds], do: part
  end

  @doc """
  Starts a gateway of vehicles, without bridge, router and links, that ends with the test; gives its name. `config` has some
  keys of the configuration. Options: `:name`, `:with` (what it has besides: `:router`, `:links`, `:bridge`), `:pubsub_tick_ms`.
  """
  @spec start_gateway(map(), keyword()) :: reference()
  def start_gateway(config \\ %{}, options \\ []) do
    options = Keyword.put_new_lazy(options, :name, &make_ref/0)
    start = {__MODULE__, :start_link, [config, options]}

    ExUnit.Callbacks.start_supervised!(%{
      id: {Aerie.Gateway, options[:name]},
      type: :supervisor,
      start: start
    })

    options[:name]
  end

  @doc "The same without a test, whose end it does not follow."
  @spec start_link(map(), keyword()) :: Supervisor.on_start()
  def start_link(config, options) do
    name = Keyword.fetch!(options, :name)
    tick = [tick_ms: Keyword.get(options, :pubsub_tick_ms, 5)]

    children =
      for part <- parts(Keyword.get(options, :with, [])) do
        more = if part == Aerie.Base.PubSub, do: tick, else: []
        Aerie.Base.Names.Successor.child_spec({part, part(part, name, config) ++ more})
      end

    strategy = [strategy: :rest_for_one, max_restarts: 3, max_seconds: 60]
    Supervisor.start_link(children, strategy ++ [name: Aerie.Base.Names.via(name, :gateway)])
  end

  # No NATS, sockets or clients unless the test asks for them.
  @quiet %{nats: %{mode: :off}, sockets: %{enabled: false}, clients: []}

  @doc "The options of a part of a gateway as `Aerie.Gateway` in `apps/aerie` starts it: settings, and the parts above."
  @spec part(module(), term(), map()) :: keyword()
  def part(part, gateway, config) do
    config = Map.merge(@quiet, config)

    Aerie.LinkCase.options(part, gateway, config) ++
      plugs(config) ++ [children: [Aerie.LinkCase.clients(gateway, config)]]
  end

  @doc "What parts are given of those above them, as options of all of them: each takes its own."
  @spec plugs(map()) :: keyword()
  def plugs(config) do
    own = [
      tables: [
        Aerie.Vehicle.Events.Journal.table(Aerie.Vehicle.Events.Journal.Settings.from(config)),
        Aerie.Vehicle.Services.StreamDemand.table()
      ],
      vehicles: Aerie.Vehicle.Supervisor,
      requests: Aerie.Vehicle.Services.Streams,
      events: Aerie.Vehicle.Events.External
    ]

    for module <- above(), reduce: own do
      plugs -> Keyword.merge(plugs, module.plugs(config), fn _key, lower, higher -> lower ++ higher end)
    end
  end

  @doc "The keys of the vehicles that have a supervision tree."
  @spec trees(term()) :: [Aerie.Base.Store.vehicle_key()]
  def trees(gateway), do: for({key, _pid, _options} <- Aerie.Base.Names.all(gateway, :tree), do: key)

  @doc "See `Aerie.Patience.eventually/1`."
  @spec eventually((-> result)) :: result when result: term()
  defdelegate eventually(fun), to: Aerie.Patience
end
