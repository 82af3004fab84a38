defmodule Aerie.Control.TransferExecutor.Progress do
  @moduledoc "The progress of a transfer in the terms of a command's progress. Pure."

  @doc "`progress` (0..1 or nil) and `text` as commands have them, with `phase`, `done` and `total`."
  @spec plain(term()) :: %{String.t() => term()}
  def plain({:waiting, whose}),
    do: %{
      "progress" => nil,
      "text" => "waits: " <> waits(whose),
      "phase" => "waiting",
      "done" => 0,
      "total" => nil
    }

  def plain({done, total}), do: plain(%{phase: :reading, done: done, total: total})

  def plain(%{phase: phase, done: done, total: total}) do
    # The size of a generated file is not known in advance.
    share = if total > 0, do: Float.round(min(done / total, 1.0), 3)

    %{
      "progress" => share,
      "text" => "#{phase}: #{done} of #{total}",
      "phase" => Atom.to_string(phase),
      "done" => done,
      "total" => total
    }
  end

  defp waits(nil), do: "another transfer with the vehicle is under way"

  defp waits({system, component}),
    do: "the ground station #{system}/#{component} has a transfer with the vehicle"
end
