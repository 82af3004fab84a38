defmodule Aerie.Control.Params.MetadataTest do
  use Aerie.TransferCase, async: true

  alias Aerie.Control.Params
  alias Aerie.LossyLink
  alias Aerie.Control.Params.Metadata
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag :capture_log
  @general "etc/extras/component_general.json.xz"
  @file_path "/etc/extras/parameters.json.xz"

  @params JSON.encode!(%{
            version: 1,
            parameters: [
              %{
                name: "MPC_XY_VEL_MAX",
                type: "Float",
                shortDesc: "Maximum horizontal velocity",
                longDesc: "In any mode.",
                units: "m/s",
                min: 0,
                max: 20,
                default: 12,
                increment: 1,
                decimalPlaces: 0,
                group: "Position Control",
                rebootRequired: false
              },
              %{
                name: "COM_FLTMODE1",
                type: "Int32",
                shortDesc: "Mode",
                rebootRequired: true,
                values: [
                  %{value: -1, description: "Unassigned"},
                  %{value: 0, description: "Manual"},
                  %{value: "x"}
                ],
                bitmask: [%{index: 2, description: "third"}]
              },
              %{name: ""},
              %{shortDesc: "without a name"},
              7
            ]
          })

  defp general(crc, uri \\ "mftp://" <> @file_path),
    do:
      JSON.encode!(%{
        version: 1,
        metadataTypes: [%{type: 4, uri: "mftp://x"}, %{type: 1, uri: uri, fileCrc: crc}]
      })

  defp xz(text, dir) do
    path = Path.join(dir, "packed")
    File.write!(path, text)
    {packed, 0} = System.cmd("xz", ["--stdout", "--check=crc32", path])
    packed
  end

  test "a vehicle's descriptions, read once and again when it names another checksum; damaged ones are not kept",
       %{
         tmp_dir: dir
       } do
    {gateway, port} = start(dir)
    packed = xz(@params, dir)
    files = %{@general => xz(general(:erlang.crc32(packed)), dir), @file_path => packed}
    sim = fly(gateway, port, firmware: :px4, files: files, loss: 0.02)
    assert {:ok, all} = Params.metadata(gateway, "VID-001", progress: {self(), :first})

    assert %{
             unit: "m/s",
             min: 0,
             max: 20,
             short: "Maximum horizontal velocity",
             reboot_required: false,
             values: []
           } =
             all["MPC_XY_VEL_MAX"]

    assert %{
             reboot_required: true,
             values: [%{value: -1, text: "Unassigned"}, %{value: 0}],
             bits: [%{bit: 2}]
           } =
             all["COM_FLTMODE1"]

    assert map_size(all) == 2
    assert [kept] = Path.wildcard(Path.join(dir, "params/*.metadata"))
    assert File.read!(kept) == @params
    # Not read again: the file is not there any more.
    assert {:ok, %Result{status: :completed}} = Aerie.Control.Files.remove(gateway, "VID-001", @file_path)
    assert {:ok, ^all} = Params.metadata(gateway, "VID-001")

    # The ledger of a machine that stands still for seconds refuses it.
    write = fn path, bytes ->
      written? = &match?({:ok, %Result{status: :completed}}, &1)
      eventually(fn -> written?.(Aerie.Control.Files.write(gateway, "VID-001", path, bytes)) end)
    end

    write.(@general, xz(general(77), dir))
    assert {:error, %Result{details: %{"rule" => "file"}}} = Params.metadata(gateway, "VID-001")
    write.(@file_path, packed)
    assert {:ok, ^all} = Params.metadata(gateway, "VID-001")
    assert [^kept] = Path.wildcard(Path.join(dir, "params/*.metadata"))
    write.(@file_path, binary_part(packed, 0, 40))
    assert {:error, %Result{status: :failed, reason: reason}} = Params.metadata(gateway, "VID-001")
    assert reason =~ "damaged"
    assert Process.alive?(sim)
  end

  test "a vehicle that has none says so, or nothing", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    fly(gateway, port, firmware: :ardupilot)

    # Half a minute is too short on a busy machine.
    assert %Result{status: :failed, reason: reason} =
             eventually(fn ->
               {:error, result} = Params.metadata(gateway, "VID-001")
               result.status != :timeout && result
             end)

    assert reason =~ "COMPONENT_METADATA"
  end

  test "whatever the files say" do
    assert {:ok, {"mftp:///etc/p.json", 5}} = Metadata.general(general(5, "mftp:///etc/p.json"))
    assert {:error, "the vehicle describes no parameters"} = Metadata.general(~s({"metadataTypes": []}))

    for bad <- ["", "[]", "{", ~s({"metadataTypes": 5}), ~s({"metadataTypes": [{"type": 1}]})],
        do: assert({:error, _why} = Metadata.general(bad))

    for bad <- [
          "https://x.org/p.json",
          "mftp://",
          "mftp://[;comp=100]/p.json",
          "mftp:///" <> String.duplicate("x", 300)
        ],
        do: assert({:error, _why} = Metadata.path(bad))

    for bad <- ["", "[]", ~s({"version": 2, "parameters": []}), ~s({"version": 1, "parameters": {}})],
        do: assert({:error, _why} = Metadata.decode(bad))

    many = JSON.encode!(%{version: 1, parameters: for(n <- 1..5_001, do: %{name: "P#{n}"})})
    assert {:error, "the metadata describes 5001 parameters" <> _} = Metadata.decode(many)

    long =
      JSON.encode!(%{
        version: 1,
        parameters: [%{name: "A", longDesc: String.duplicate("x", 9_000), units: 5}]
      })

    assert {:ok, %{"A" => %{long: long, unit: nil}}} = Metadata.decode(long)
    assert String.length(long) == 4_000
  end

  test "what unpacks to more than is read is not unpacked", %{tmp_dir: dir} do
    assert {:ok, "plain"} = Metadata.Unpack.file("x.json", "plain")
    assert {:ok, "text"} = Metadata.Unpack.file("x.json.xz", xz("text", dir))
    assert {:error, "the vehicle's compressed metadata is damaged"} = Metadata.Unpack.file("x.xz", "no xz")
    bomb = xz(:binary.copy(<<0>>, 40_000_000), dir)
    assert byte_size(bomb) < 100_000
    assert {:error, "the metadata has more than" <> _} = Metadata.Unpack.file("x.xz", bomb)
    refute_received {_port, _late}
  end

  test "the question is repeated, and given up" do
    answer = fn v, %M.CommandLong{command: 512, param1: 397.0}, _now ->
      {v, [{1_000, %M.ComponentMetadata{uri: "mftp://x"}}]}
    end

    source = Metadata.Source.new({1, 1}, 60_000_000)
    assert {:ok, "mftp://x"} = LossyLink.run(Metadata.Source, source, nil, answer, loss: 0.3, seed: 2).result
    run = LossyLink.run(Metadata.Source, source, nil, fn v, _m, _now -> {v, []} end)
    assert {:error, {:failed, _why}} = run.result
    assert length(run.sent) == 5
  end

  test "on a fast link a vehicle may stand still for seconds before it is given up" do
    source = Metadata.Source.new({1, 1}, 60_000_000, rtt_us: 5_000)

    answer = fn v, %M.CommandLong{command: 512}, _now ->
      {v, [{1_000, %M.ComponentMetadata{uri: "mftp://x"}}]}
    end

    asleep = LossyLink.still(7_000_000, answer)
    assert {:ok, "mftp://x"} = LossyLink.run(Metadata.Source, source, nil, asleep).result
    run = LossyLink.run(Metadata.Source, source, nil, fn v, _m, _now -> {v, []} end)
    assert {:error, {:failed, _why}} = run.result
    assert {run.at, length(run.sent)} == {8_700_000, 13}
  end
end
