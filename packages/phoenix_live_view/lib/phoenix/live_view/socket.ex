defmodule Phoenix.LiveView.Socket do
  @moduledoc """
  The state of a view: its `assigns`, and the requests since the last rendering (redirects, events for the client).

  Views may read only `assigns`, `view`, `router`, `host_uri`, `id` and `transport_pid`; the rest belongs to the
  library.
  """

  defstruct id: nil,
            endpoint: nil,
            view: nil,
            router: nil,
            host_uri: nil,
            parent_pid: nil,
            root_pid: nil,
            transport_pid: nil,
            assigns: %{__changed__: %{}, flash: %{}, live_action: nil},
            redirected: nil,
            private: %{}

  @type t :: %__MODULE__{}
end
