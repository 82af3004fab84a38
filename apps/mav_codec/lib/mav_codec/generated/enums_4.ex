defmodule MavCodec.Generated.Enums4 do
  use MavCodec.Definition.Shard, enums: {4, 4}
end
