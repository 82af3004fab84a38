defmodule Aerie.Programs do
  @moduledoc "The operating system processes that this VM started, to see whether any is left behind."

  @doc "Their process ids. The BEAM starts programs through a helper process, so they are its grandchildren."
  @spec running() :: [String.t()]
  def running, do: descendants(System.pid())

  defp descendants(pid) do
    with {:ok, tasks} <- File.ls("/proc/#{pid}/task") do
      for task <- tasks,
          {:ok, children} <- [File.read("/proc/#{pid}/task/#{task}/children")],
          child <- String.split(children),
          program <- [child | descendants(child)],
          do: program
    else
      _ended_meanwhile -> []
    end
  end
end
