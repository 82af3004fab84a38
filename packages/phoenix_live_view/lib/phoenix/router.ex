defmodule Phoenix.Router do
  @moduledoc """
  `use Phoenix.Router` makes a module a router. What it routes comes from `import Phoenix.LiveView.Router`: live views are all that
  there is to route to. It takes the namesake's options and needs none.
  """

  @doc false
  defmacro __using__(_options) do
    quote do
      Module.register_attribute(__MODULE__, :live_routes, accumulate: true)
      @live_session %{name: :default, on_mount: [], layout: nil}
      @before_compile Phoenix.Router
    end
  end

  @doc false
  defmacro __before_compile__(_env) do
    quote do
      @doc false
      def __live_routes__, do: Enum.reverse(@live_routes)
    end
  end

  @doc "What a router routes, in its order; each with its `:path` as it was written, parameters with their colons."
  @spec routes(module()) :: [%{path: String.t(), verb: :get}]
  def routes(router) do
    for %{segments: segments} <- router.__live_routes__(),
        do: %{path: "/" <> Enum.join(segments, "/"), verb: :get}
  end
end
