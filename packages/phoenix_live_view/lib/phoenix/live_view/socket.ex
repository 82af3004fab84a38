defmodule Phoenix.LiveView.Socket do
  @moduledoc """
  The state of a view: its `assigns`, and the requests since the last rendering (redirects, events for the client).

  Views may read only `assigns`, `view`, `router`, `host_uri`, `id` and `transport_pid`; the rest belongs to the
  library.
  """

  alias Phoenix.LiveView.{Router, Server}

  defstruct id: nil,
            view: nil,
            router: nil,
            host_uri: nil,
            transport_pid: nil,
            assigns: %{__changed__: %{}, flash: %{}},
            redirected: nil,
            private: %{}

  @type t :: %__MODULE__{}

  @doc false
  @spec new(Server.t(), Router.Route.t(), URI.t(), flash :: map(), keyword()) :: t()
  def new(server, route, uri, flash, fields) do
    struct!(
      %__MODULE__{
        view: route.view,
        router: server.router,
        host_uri: %{uri | path: nil, query: nil, fragment: nil},
        assigns: %{__changed__: %{}, flash: flash}
      },
      fields
    )
  end
end
