defmodule MavRouter.Sharing.ReadCache do
  @moduledoc """
  Requests of clients for parameters and plans, which a module with these callbacks, given to
  `MavRouter.Router.Supervisor` (`:readings`), may answer in the vehicle's name, so that a vehicle is read once and not
  once per screen. The rule `served` of a client turns it on; for clients that may not ask the vehicle it is always on.
  Without such a module all of them go to the vehicle.
  """

  alias Aerie.Base.Names
  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Forward
  alias MavRouter.Forward.Cache
  alias MavRouter.Forward.Gate
  alias MavRouter.Endpoints.Output
  alias MavRouter.Forward.Source
  alias MavRouter.Tables
  alias MavRouter.Sharing.TransferLock
  alias Aerie.Base.Store
  alias MavCodec.Frame

  @doc "Whether a frame may be such a request, or changes what they read. Must be cheap: it is asked of every frame of a client."
  @callback reading?(Frame.t()) :: boolean

  @doc """
  A request of a client to a vehicle; its target is the vehicle's own id. `:absorb`: it is answered by `answer/4`, or
  goes on later by `forward/3`.
  """
  @callback take(Names.gateway(), MavRouter.Router.vehicle_key(), Endpoint.key(), Frame.t()) ::
              :forward | :absorb

  @doc "The delivery without the frames that do not go on; only trusted ones are answered."
  @spec pass(Delivery.t()) :: Delivery.t()
  def pass(
        %{frames: frames, tables: %{readings: readings}, path: %{side: :client, role: :full} = path} =
          delivery
      )
      when readings != nil and (path.served or delivery.scope == :clients) do
    # Nearly always there is none.
    if Enum.any?(frames, &readings.reading?/1),
      do: %{delivery | frames: Enum.reject(frames, &absorbed?(&1, delivery))},
      else: delivery
  end

  def pass(delivery), do: delivery

  # A client that uses other ids for vehicles reads them itself.
  defp absorbed?(_frame, %{path: %{renumber: offsets}}) when offsets != nil, do: false

  defp absorbed?(frame, %{gateway: gateway, tables: %{readings: readings}, path: path, trusted: trusted}) do
    with true <- readings.reading?(frame) and frame in trusted,
         true <- path.in == nil or Filter.pass?(path.in, frame, path.owner),
         {id, component} <- Frame.target(frame),
         {_network, _system} = vehicle <- vehicle(gateway, path, id, component) do
      readings.take(gateway, vehicle, path.key, frame) == :absorb
    else
      _other -> false
    end
  end

  # A camera has parameters of its own.
  defp vehicle(gateway, path, id, component) do
    Enum.find_value(path.networks, fn network ->
      with %{component: autopilot} <- Store.vehicle(gateway, {network, id}),
           true <- component == autopilot or (component == 0 and alone?(gateway, {network, id})),
           do: {network, id},
           else: (_none -> nil)
    end)
  end

  defp alone?(gateway, key), do: match?(%{components: all} when map_size(all) < 2, Store.system(gateway, key))

  @doc """
  Sends frames to an endpoint; one that is gone gets none. They have the classes of their messages. `cache` is what the
  call before gave, nil for the first one.
  """
  @spec answer(Names.gateway(), Endpoint.key(), [iodata], Cache.t() | nil) :: Cache.t() | nil
  def answer(gateway, key, frames, cache) do
    with tables when tables != nil <- Tables.of(gateway) do
      cache = Cache.refresh(cache, tables)
      path = cache.forwarding.paths[key]
      if path, do: Enum.each(frames, &send_out(IO.iodata_to_binary(&1), path))
      cache
    end
  end

  defp send_out(bytes, path) do
    {:ok, _header, _payload, _total, id, _system} = Frame.header(bytes)
    Output.bytes(path, bytes, TrafficClass.of(id), 1)
  end

  @doc """
  A request that was absorbed goes on to the vehicle, as if it came now; that of a client that may not ask goes nowhere.
  """
  @spec forward(Names.gateway(), Endpoint.key(), Frame.t()) :: :ok
  def forward(gateway, key, frame) do
    with tables when tables != nil <- Tables.of(gateway),
         cache = Cache.refresh(nil, tables),
         %Delivery{} = delivery <- Cache.delivery(cache, gateway, tables, key) do
      %{delivery | source: Source.new(frame.system, frame.component), frames: [frame]}
      |> Source.refresh()
      |> Gate.sort()
      |> Enum.each(&(&1 |> TransferLock.pass() |> Forward.frames()))
    else
      _gone -> :ok
    end
  end
end
