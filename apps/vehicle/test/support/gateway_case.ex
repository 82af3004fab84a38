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

  @doc "Starts a gateway of vehicles, without bridge, router and links, that ends with the test; gives its name."
  @spec start_gateway(map() | struct(), keyword()) :: reference()
  def start_gateway(config \\ %{}, options \\ []) do
    name = make_ref()

    without = [Aerie.Bridge.Supervisor, Aerie.Router.Supervisor, Aerie.Link.Supervisor]
    defaults = [name: name, config: config, pubsub_tick_ms: 5, without: without]
    ExUnit.Callbacks.start_supervised!({Aerie.Gateway, Keyword.merge(defaults, options)})

    name
  end

  @doc "See `Aerie.Patience.eventually/1`."
  @spec eventually((-> result)) :: result when result: term()
  defdelegate eventually(fun), to: Aerie.Patience
end
