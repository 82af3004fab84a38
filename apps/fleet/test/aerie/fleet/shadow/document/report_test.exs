defmodule Aerie.Fleet.Shadow.Document.ReportTest do
  @moduledoc "What is in a reported document, and its size."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Shadow.{Document, Update}
  alias Aerie.Fleet.Shadow.Loop.Core
  alias Aerie.Fleet.Shadow.Document.Report

  defp document(count, state, why \\ 20) do
    fields =
      for n <- 1..count, into: %{} do
        name = "params.P#{String.pad_leading("#{n}", 3, "0")}"
        {name, %{"state" => state.(n), "why" => String.duplicate("w", why), "desired" => n, "version" => 1}}
      end

    %{"vehicle" => "VID-001", "fields" => fields}
  end

  test "what the vehicle is and has, what is desired of it and how it stands, and who holds it" do
    now = 1_800_000_000_000_000

    {:ok, update} =
      Update.parse(%{"desired" => %{"mode" => "RTL", "tags" => ["a"]}, "reason" => "storm"}, now)

    {:ok, desired} = Document.apply(Document.new("V"), update, %{actor: "ops", via: "rest"}, now)

    snapshot = %Aerie.Vehicle.Snapshot{
      status: :online,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      firmware: "4.6.0",
      capabilities: 0xFF,
      links: ["radio", "lte"],
      collision: nil,
      time_boot_ms: 1,
      groups: %{
        mode: %{data: %{mode: "GUIDED", armed: true, in_air: true, failsafe: true}},
        health: %{data: %{ready_to_arm: true, rc_receiver: false, fence_enabled: true, load: 0.5}}
      }
    }

    view = %{now: now, snapshot: snapshot, commanded: nil, holds: [], beside: %{}}
    core = "V" |> Core.new(hold_us: 30_000_000, max_tries: 6, allow_arming: false) |> Core.desired(desired)
    {core, _actions} = Core.compare(core, view)

    assert %{
             "vehicle" => "V",
             "gateway" => "gateway-V",
             "desired_version" => 1,
             "status" => "online",
             "autopilot" => "ardupilot",
             "type" => "copter",
             "firmware" => "4.6.0",
             "capabilities" => 0xFF,
             "links" => ["lte", "radio"],
             "mode" => "GUIDED",
             "armed" => true,
             "in_air" => true,
             "tags" => ["a"],
             "geofence" => %{"enabled" => true},
             "health" => health,
             "fields" => %{"mode" => %{"state" => "held", "by" => by}, "tags" => %{"state" => "converged"}},
             "holds" => holds
           } = Report.document(snapshot, core, view.beside, "gateway-V")

    # Not what changes all the time.
    assert health == %{ready_to_arm: true, rc_receiver: false}
    assert by in ["begun", "failsafe"]
    assert "failsafe" in for(%{"by" => by} <- holds, do: by)
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
