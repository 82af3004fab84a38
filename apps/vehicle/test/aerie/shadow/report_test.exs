defmodule Aerie.Shadow.ReportTest do
  @moduledoc "The size of a reported document."
  use ExUnit.Case, async: true

  alias Aerie.Shadow.Report

  defp document(count, state, why \\ 20) do
    fields =
      for n <- 1..count, into: %{} do
        name = "params.P#{String.pad_leading("#{n}", 3, "0")}"
        {name, %{"state" => state.(n), "why" => String.duplicate("w", why), "desired" => n, "version" => 1}}
      end

    %{"vehicle" => "VID-001", "fields" => fields}
  end

  test "one that is small enough stays as it is" do
    document = document(250, fn _n -> "refused" end)
    assert Report.bounded(document) == {document, 0}
  end

  test "too large, it leaves out fields that agree, then others, and says how many" do
    mixed = document(250, fn n -> if n > 100, do: "converged", else: "refused" end, 500)
    assert {%{"omitted_fields" => 150, "fields" => fields} = shorter, 150} = Report.bounded(mixed)
    assert map_size(fields) == 100
    assert Enum.all?(fields, fn {_path, status} -> status["state"] == "refused" end)
    assert byte_size(JSON.encode!(shorter)) <= Report.max_bytes()

    assert {%{"fields" => fields} = shorter, omitted} =
             Report.bounded(document(250, fn _n -> "held" end, 2_000))

    assert omitted == 250 - map_size(fields) and map_size(fields) > 0
    assert is_map_key(fields, "params.P001")
    assert byte_size(JSON.encode!(shorter)) <= Report.max_bytes()

    assert {%{"fields" => none}, 1} = Report.bounded(document(1, fn _n -> "held" end, 100_000))
    assert none == %{}
  end
end
