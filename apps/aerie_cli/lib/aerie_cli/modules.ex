defmodule AerieCLI.Modules do
  @moduledoc """
  Loads the code of the gateway and of all it uses, once it runs. Code that is loaded when it is first called is loaded
  from a file, and that fails just when it is needed: with all descriptors used up, or with the files gone.

  In the background, because a vehicle that flies waits for its gateway and not for this (some seconds), and one after the
  other by a process of low priority, which prepares the code itself: many at once would go before what is needed now.
  """

  require Logger

  @doc "Begins to load. Gives the process that does, which ends when all is loaded."
  @spec load() :: pid()
  def load do
    {:ok, pid} =
      Task.start(fn ->
        Process.set_label(:module_loader)
        Process.flag(:priority, :low)
        failed = for module <- all(), {:error, reason} <- [:code.ensure_loaded(module)], do: {module, reason}
        if failed != [], do: Logger.warning("code that cannot be loaded: #{inspect(failed)}")
      end)

    pid
  end

  @doc "The modules of the gateway's applications, ours first, and of those that they depend on."
  @spec all() :: [module()]
  def all,
    do:
      for(app <- applications([:aerie_cli], []), module <- Application.spec(app, :modules) || [], do: module)

  defp applications([], known), do: Enum.reverse(known)

  defp applications([app | rest], known) do
    if app in known,
      do: applications(rest, known),
      else: applications(rest ++ (Application.spec(app, :applications) || []), [app | known])
  end
end
