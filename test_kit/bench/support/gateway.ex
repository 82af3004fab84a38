defmodule Bench.Gateway do
  @moduledoc """
  Gateways in this VM: with all of their parts, or with those that are measured. No clients, no local UDP port; files
  below one folder.
  """

  alias Aerie.Base.Store

  @doc "Calls `fun` with a temporary folder."
  @spec in_folder(String.t(), (Path.t() -> result)) :: result when result: term()
  def in_folder(name, fun) do
    folder =
      Path.join(
        System.tmp_dir!(),
        "aerie-bench-#{name}-#{System.pid()}-#{System.unique_integer([:positive])}"
      )

    File.mkdir_p!(folder)

    try do
      fun.(folder)
    after
      File.rm_rf!(folder)
    end
  end

  @doc "The configuration with `more` keys."
  @spec config(Path.t(), [{String.t(), term()}]) :: Aerie.Config.t()
  def config(folder, more \\ []) do
    dirs = ~w(outbox recorder signing policy.audit commands.ledger params shadow sockets console tracks)

    Aerie.Config.default(
      for(name <- dirs, do: {name <> ".dir", Path.join(folder, name)}) ++
        [
          {"nats.store_dir", Path.join(folder, "nats")},
          {"mavlink.local_addr", "off"},
          {"mavlink.system_id", 245},
          {"clients", []},
          {"limits.max_links", 200}
        ] ++ more
    )
  end

  @doc "Starts those of the parts that are `measured`."
  @spec parts(term(), Aerie.Config.t(), [module()]) :: [pid()]
  def parts(gateway, config, measured) do
    for {module, options} <- Aerie.Gateway.parts(gateway, config), module in measured do
      {:ok, pid} = module.start_link([gateway: gateway] ++ options)
      pid
    end
  end

  @doc "Starts a whole gateway, and its pages if there are to be any."
  @spec whole(term(), Aerie.Config.t(), boolean()) :: pid()
  def whole(gateway, config, pages? \\ false) do
    {:ok, pid} = Aerie.Gateway.start_link(name: gateway, config: config)

    if pages? do
      settings = Aerie.Api.Settings.from(config)
      pages = &Aerie.Console.HTTP.Routes.serve(gateway, settings.console, nil, &1)
      {:ok, _} = Aerie.Api.Endpoint.start_link(gateway: gateway, settings: settings, pages: pages)
    end

    pid
  end

  @doc "Starts a link; gives its port."
  @spec link(term(), String.t(), keyword()) :: :inet.port_number()
  def link(gateway, url \\ "udpin:127.0.0.1:0", options \\ []) do
    {:ok, id} = MavRouter.Link.start(gateway, url, options)
    Bench.Sample.until(fn -> Store.link(gateway, id)[:port] end)
  end

  @doc "Adds a client; gives its port."
  @spec client(term(), String.t() | map()) :: :inet.port_number()
  def client(gateway, url) do
    {:ok, id} = MavRouter.Client.add(gateway, url)
    Enum.find(MavRouter.Client.endpoints(gateway), &(&1.id == id)).port
  end

  @doc "Starts a simulated ArduPilot on a port."
  @spec sim(:inet.port_number(), keyword()) :: pid()
  def sim(port, options \\ []) do
    {:ok, sim} = SimVehicle.start_link([firmware: :ardupilot, link: "udpout:127.0.0.1:#{port}"] ++ options)
    sim
  end

  @doc "The sum of a metric of the bridge."
  @spec metric(term(), String.t()) :: number()
  def metric(gateway, name) do
    for(
      %{name: ^name, samples: samples} <- Aerie.Fleet.Bridge.metrics(gateway),
      {_labels, n} <- samples,
      do: n
    )
    |> Enum.sum()
  end
end
