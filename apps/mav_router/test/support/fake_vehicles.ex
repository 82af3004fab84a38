defmodule Aerie.FakeVehicles do
  @moduledoc """
  Vehicles for tests of the router: their sessions do nothing but tell the test what they get, as
  `{:session, vehicle key, sender, frames}`.
  """
  use GenServer

  @behaviour MavRouter.Router.Vehicles

  alias Aerie.Base.Names

  @doc "The parts of `Aerie.LinkCase.start_parts/2` for a router with at most so many of these vehicles."
  @spec parts(pos_integer) :: keyword
  def parts(limit), do: [before: [{__MODULE__, test: self(), limit: limit}], options: [vehicles: __MODULE__]]

  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :vehicles))

  @impl MavRouter.Router.Vehicles
  def ensure(gateway, key),
    do: GenServer.call(Names.via(gateway, :vehicles), {:ensure, key}, Aerie.Patience.ms())

  @impl GenServer
  def init(options) do
    {:ok, Map.new(Keyword.take(options, [:gateway, :test, :limit]))}
  end

  @impl GenServer
  def handle_call({:ensure, key}, _from, %{gateway: gateway} = state) do
    cond do
      session = Names.whereis(gateway, :session, key) -> {:reply, {:ok, session}, state}
      length(Names.processes(gateway, :session)) >= state.limit -> {:reply, {:error, :too_many}, state}
      true -> {:reply, {:ok, start(state, key)}, state}
    end
  end

  defp start(%{gateway: gateway, test: test}, key) do
    vehicles = self()

    session =
      spawn_link(fn ->
        :ok = Names.register(gateway, :session, key)

        with {:frames, sender, frames} <- MavRouter.Router.first_frames(gateway, key),
             do: send(test, {:session, key, sender, frames})

        send(vehicles, {:started, self()})
        tell(test, key)
      end)

    receive(do: ({:started, ^session} -> session))
  end

  defp tell(test, key) do
    receive do
      {:frames, sender, frames} ->
        send(test, {:session, key, sender, frames})
        tell(test, key)
    end
  end
end
