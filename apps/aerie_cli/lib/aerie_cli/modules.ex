defmodule AerieCLI.Modules do
  @moduledoc """
  Loads the code of the gateway and of all it uses, once it runs. Code that is loaded when it is first called is loaded
  from a file, and that fails just when it is needed: with all descriptors used up, or with the files gone.

  In the background, because a vehicle that flies waits for its gateway and not for this (two seconds), and in small
  portions, so that code which is called meanwhile is not queued behind all of it.
  """

  require Logger

  @portion 25

  @doc "Begins to load. Gives the process that does, which ends when all is loaded."
  @spec load() :: pid()
  def load do
    {:ok, pid} =
      Task.start(fn ->
        Process.set_label(:module_loader)
        Process.flag(:priority, :low)
        all() |> Enum.reject(&:erlang.module_loaded/1) |> Enum.chunk_every(@portion) |> Enum.each(&portion/1)
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

  defp portion(modules) do
    with {:error, failed} <- :code.ensure_modules_loaded(modules) do
      # Debian leaves parts of some packages out; what is ours must be there.
      Logger.warning("code that cannot be loaded, and is not there when it is called: #{inspect(failed)}")
    end
  end
end
