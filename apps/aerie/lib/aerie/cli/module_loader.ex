defmodule Aerie.CLI.ModuleLoader do
  @moduledoc """
  Loads all modules of the gateway and its dependencies after the start. The BEAM otherwise reads a module's file at the
  first call, which fails when file descriptors have run out or the files are gone.

  Loading takes some seconds, so it runs in the background: a flying vehicle must not wait for it. One process of low
  priority loads one module after the other; a batch would delay modules that are needed at once.
  """

  require Logger

  @doc "Starts loading. Returns the pid of the loading process, which ends when all modules are loaded."
  @spec load() :: pid()
  def load do
    {:ok, pid} =
      Task.start(fn ->
        Process.set_label(:module_loader)
        Process.flag(:priority, :low)
        failed = for module <- all(), {:error, reason} <- [:code.ensure_loaded(module)], do: {module, reason}
        if failed != [], do: Logger.warning("some modules cannot be loaded: #{inspect(failed)}")
      end)

    pid
  end

  @doc "The modules of the gateway's applications and of their dependencies; Aerie's own come first."
  @spec all() :: [module()]
  def all do
    # Nothing starts it; a release does not have it.
    _ = Application.load(:sim_vehicle)
    apps = applications([:aerie, :sim_vehicle], [])
    for app <- apps, module <- Application.spec(app, :modules) || [], do: module
  end

  defp applications([], known), do: Enum.reverse(known)

  defp applications([app | rest], known) do
    if app in known,
      do: applications(rest, known),
      else: applications(rest ++ (Application.spec(app, :applications) || []), [app | known])
  end
end
