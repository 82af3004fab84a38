defmodule Aerie.Console.Part do
  @moduledoc "Parts of a page that are rendered when they change, and not with each value that the page shows."

  import Phoenix.Component, only: [assign: 3]

  alias Phoenix.LiveView.{Rendered, Socket}

  @doc "Renders a component into an assign, unless it was given the same values the last time."
  @spec keep(Socket.t(), atom(), (map() -> Rendered.t()), given :: map()) :: Socket.t()
  def keep(%{private: private} = socket, name, component, given) do
    if private[{:part, name}] == given do
      socket
    else
      rendered = component.(Map.put(given, :__changed__, nil))
      assign(%{socket | private: Map.put(private, {:part, name}, given)}, name, rendered)
    end
  end
end
